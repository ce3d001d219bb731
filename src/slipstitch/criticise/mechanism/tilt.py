"""Tilt: the floor falls by a small angle towards some lab azimuth."""

import numpy as np

from slipstitch.criticise.mechanism.bench_mechanism import BenchMechanism
from slipstitch.friction_law import Parameter


class Tilt(BenchMechanism):
    """Fitted as two components, in degrees, so that no tilt is a regular point."""

    def changes(self, values):
        return {
            "tilt_along_rad": np.radians(values["tilt_along"]),
            "tilt_across_rad": np.radians(values["tilt_across"]),
        }


MECHANISM = Tilt(
    "tilt",
    "the floor is tilted",
    (
        Parameter("tilt_along", "deg", 0.0, 0.3, -20.0, 20.0),
        Parameter("tilt_across", "deg", 0.0, 0.3, -20.0, 20.0),
    ),
    needs=("azimuth",),
)
