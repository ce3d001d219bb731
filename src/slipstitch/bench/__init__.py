"""The bench, common to all stages: path of the stage, gravity, sampled frames, departures."""
