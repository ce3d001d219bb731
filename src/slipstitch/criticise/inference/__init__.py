"""From features to a verdict: covariance, tests with family-wise error, fits, selection, gain."""
