"""From raw tables to features (one number with its uncertainty) and their forward models."""

from slipstitch.criticise.features.assembly import Measurements, assemble

__all__ = ["Measurements", "assemble"]
