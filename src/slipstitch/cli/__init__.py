"""The command line: one file per verb; the computations are in the packages below."""
