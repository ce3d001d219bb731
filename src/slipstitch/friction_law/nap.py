"""Nap: friction differs with and against the warp direction."""

import numpy as np

from slipstitch.friction_law.mechanism import ContactMechanism, Parameter


def factor(nap, direction_rad):
    """1 + a cos phi: sliding back has the other sign."""
    return 1.0 + nap * np.cos(direction_rad)


MECHANISM = ContactMechanism(
    "nap",
    "friction with the nap differs from friction against it",
    (Parameter("nap", "1", 0.0, 0.05, -0.9, 0.9),),
    needs=("direction_rad",),
    factor=factor,
    unrecorded={"direction_rad": np.pi / 2},
)
