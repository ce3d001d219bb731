"""Howell's and Bowden and Young's power law: friction grows as the load to a power n = 1 + m."""

import numpy as np

from slipstitch.friction_law.mechanism import ContactMechanism, Parameter

LEAST_RATIO = 1.0e-9  # of the load to the reference: below, the power is cut off


def factor(load_power, load_ratio):
    """(p / p0)^m, p0 = 50 Pa; at an edge (N / 2 mN)^m."""
    return np.maximum(load_ratio, LEAST_RATIO) ** load_power


MECHANISM = ContactMechanism(
    "load_power",
    "friction grows less (or more) than in proportion to the load",
    (Parameter("load_power", "1", 0.0, 0.05, -0.9, 0.9),),
    needs=("normal_force_N",),
    factor=factor,
)
