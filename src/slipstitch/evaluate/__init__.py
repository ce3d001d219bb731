"""Evaluate: what the trained networks are worth on videos they have not seen."""
