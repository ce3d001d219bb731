"""Surrogate captures: simulations made unlike the training data, to stand for a real bench."""
