"""Surrogate captures: simulations with a distribution shift, as a substitute for a real bench."""
