"""Measure: friction read off one video of a bench."""
