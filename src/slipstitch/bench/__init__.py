"""The bench that every stage shares: path of the stage, gravity, sampled frames, departures."""
