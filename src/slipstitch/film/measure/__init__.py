"""Measure: friction from a video of a bench."""

from pathlib import Path

#: The instrument that comes with Slipstitch: weights, card, and the configuration of its training.
SHIPPED = Path(__file__).with_name("shipped")
