"""Audit: verify a release, trace each clip to its origin, compare it with the current code."""
