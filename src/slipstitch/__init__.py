"""Slipstitch: measure the friction coefficient of cloth from video."""

__version__ = "0.1.0"
