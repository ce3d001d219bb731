"""Known-answer experiments in the simulator, each compared with theory."""
