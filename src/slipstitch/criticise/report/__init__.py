"""The verdict as a page for the experimenter."""
