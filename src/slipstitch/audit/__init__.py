"""Audit: is a release what it says, where does each clip come from, would it be the same today."""
