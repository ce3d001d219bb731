"""Known-answer experiments in the simulator, each beside what theory says."""
