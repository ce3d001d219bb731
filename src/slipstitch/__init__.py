"""Slipstitch: read the friction coefficient of cloth off video."""

__version__ = "0.1.0"
