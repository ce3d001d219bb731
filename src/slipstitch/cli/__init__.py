"""The command line: one file a verb; what they compute lives in the packages below."""
