"""Instrument: friction from a video, with an error bar and an alarm."""
