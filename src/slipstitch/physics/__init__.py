"""The simulator, its friction law, and experiments with known answers."""

#: Acceleration of gravity (m/s²), the one value of simulator, theory and criticism. Why it is not
#: the standard 9.80665 m/s²: docs/how/physics.md.
GRAVITY_M_S2 = 9.81
