"""Training of the material and friction networks."""
