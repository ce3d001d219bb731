"""Evaluate: the trained networks on unseen videos."""
