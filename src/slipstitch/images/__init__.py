"""Blender images of simulated cloth: one shading render, every texture composed from it."""
