"""Ablations: what changes when one thing in the training changes, at an equal budget."""
