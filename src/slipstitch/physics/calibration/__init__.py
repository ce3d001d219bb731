"""Known-answer checks of the simulator with the configured settings."""
