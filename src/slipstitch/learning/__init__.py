"""Train: the networks that predict material and friction from the sampled frames."""
