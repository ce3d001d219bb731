"""Videos of a bench, converted to the format of the dataset."""
