"""Release: the dataset as a folder that others load in one line, trust and can audit."""
