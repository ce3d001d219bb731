"""Train: the networks that read material and friction off the sampled frames."""
