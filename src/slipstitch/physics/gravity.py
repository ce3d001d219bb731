"""Gravity on the bench."""

GRAVITY_M_S2 = 9.81
"""Acceleration of gravity (m/s²), the one value of simulator, theory and criticism.

See docs/how/physics.md for why it is not the standard 9.80665 m/s².
"""
