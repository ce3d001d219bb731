"""Measured data in, verdict on the model out."""
