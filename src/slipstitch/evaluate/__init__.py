"""Tables and predictions of the trained networks."""
