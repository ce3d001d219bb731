"""Wear: friction changes over the first slides of a specimen and settles."""

import numpy as np

from slipstitch.friction_law.mechanism import ContactMechanism, Parameter


def factor(wear, wear_r0, repeats):
    """1 + a (1 - exp(-r / r0)), r the slides before."""
    return 1.0 + wear * (1.0 - np.exp(-repeats / wear_r0))


MECHANISM = ContactMechanism(
    "wear",
    "friction changes with the slides that a specimen has made",
    (
        Parameter("wear", "1", 0.0, 0.1, -0.9, 3.0),
        Parameter("wear_r0", "slides", 3.0, 2.0, 0.3, 40.0),
    ),
    needs=("repeats",),
    factor=factor,
    unrecorded={"repeats": 0.0},
)
