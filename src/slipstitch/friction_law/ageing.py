"""Ageing: static friction grows with the logarithm of the rest in contact (Dieterich)."""

import numpy as np

from slipstitch.friction_law.contact import REFERENCE_DWELL_S
from slipstitch.friction_law.mechanism import ContactMechanism, Parameter


def static_factor(ageing, dwell_s):
    """1 + a log10(1 + t / 1 s)."""
    return 1.0 + ageing * np.log10(1.0 + dwell_s / REFERENCE_DWELL_S)


MECHANISM = ContactMechanism(
    "ageing",
    "static friction grows with the rest before the pull",
    (Parameter("ageing", "1/decade", 0.0, 0.05, 0.0, 2.0),),
    needs=("dwell_s",),
    static_factor=static_factor,
    unrecorded={"dwell_s": 0.0},
)
