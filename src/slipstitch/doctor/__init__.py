"""What this machine has of what Slipstitch needs, and what a configuration would cost on it."""
