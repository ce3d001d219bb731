"""The drop-and-drag protocol, simulated and written as a trajectory."""
