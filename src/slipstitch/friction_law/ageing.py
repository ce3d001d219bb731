"""Ageing: static friction grows with the logarithm of the rest in contact (Dieterich)."""

import numpy as np

from slipstitch.friction_law.contact import REFERENCE_DWELL_S
from slipstitch.friction_law.mechanism import ContactMechanism, Parameter, recorded


class Ageing(ContactMechanism):
    """Factor 1 + a log10(1 + t / 1 s) on the friction at rest."""

    def factor(self, values, contact, static):
        if not static:
            return 1.0
        dwell = recorded(contact.dwell_s, 0.0)
        return 1.0 + values["ageing"] * np.log10(1.0 + dwell / REFERENCE_DWELL_S)


MECHANISM = Ageing(
    "ageing",
    "static friction grows with the rest before the pull",
    (Parameter("ageing", "1/decade", 0.0, 0.05, 0.0, 2.0),),
    needs=("dwell_s",),
)
