"""Requirements of Slipstitch on this machine, and the estimated cost of a configuration."""
