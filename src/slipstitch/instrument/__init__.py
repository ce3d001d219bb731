"""Instrument: friction from a video, with an error bar and an alarm."""

from slipstitch.instrument.measuring import Instrument, Measurement, load_instrument

__all__ = ["Instrument", "Measurement", "load_instrument"]
