"""Frames at regular intervals, splits and the manifest: the dataset."""
