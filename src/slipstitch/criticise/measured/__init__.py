"""Adapters of published measurements, and what they say of plain Coulomb friction."""
