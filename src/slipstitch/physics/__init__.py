"""The simulator, its friction law, and experiments with known answers."""
