"""Howell's and Bowden and Young's power law: friction grows as the load to a power n = 1 + m."""

import numpy as np

from slipstitch.friction_law.mechanism import ContactMechanism, Parameter


class LoadPower(ContactMechanism):
    """Factor (p / p0)^m, p0 = 50 Pa; at an edge (N / 2 mN)^m."""

    def factor(self, values, contact, static):
        ratio = np.maximum(contact.load_ratio(), 1e-9)
        return ratio ** values["load_power"]


MECHANISM = LoadPower(
    "load_power",
    "friction grows less (or more) than in proportion to the load",
    (Parameter("load_power", "1", 0.0, 0.05, -0.9, 0.9),),
    needs=("normal_force_N",),
)
