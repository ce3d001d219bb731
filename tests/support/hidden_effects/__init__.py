"""A bench that hides effects in data. It shares no forward model and no law with the package."""
