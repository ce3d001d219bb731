"""Publish: what of a results folder is kept for readers, without its images."""
