"""Dependence of drop-and-drag on the time step and the mesh."""
