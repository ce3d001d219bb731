"""Reference friction from slip angles on an inclined plane."""
