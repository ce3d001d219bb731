"""Measure: friction from a video of a bench."""
