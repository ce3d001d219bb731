"""Predict what a verdict's null and extended models expect of a new case."""
