"""Scores of the networks on captured films."""
