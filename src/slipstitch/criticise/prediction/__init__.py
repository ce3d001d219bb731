"""Predictions of a verdict's null and extended models for a new case."""
