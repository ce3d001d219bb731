"""Videos of a bench, brought into the form of the dataset."""
