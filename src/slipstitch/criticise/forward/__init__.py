"""Analytic forward models: what an instrument reads, given a friction law and a bench."""
