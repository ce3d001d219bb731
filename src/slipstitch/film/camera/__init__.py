"""Camera calibration from images of a board."""
