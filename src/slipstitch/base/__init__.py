"""Errors, records, digests, pages: what every wing uses."""
