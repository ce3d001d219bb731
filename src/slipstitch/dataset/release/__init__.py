"""Release: the dataset as a folder that others can load in one line and audit."""
