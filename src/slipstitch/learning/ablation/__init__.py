"""Ablations: the effect of single training choices, at an equal budget."""
