"""Rate: kinetic friction changes with the logarithm of the speed."""

import numpy as np

from slipstitch.friction_law.contact import REFERENCE_SPEED_M_S
from slipstitch.friction_law.mechanism import ContactMechanism, Parameter, recorded


class Rate(ContactMechanism):
    """Factor 1 + b log10(v / 10 mm/s) on the friction in motion."""

    def factor(self, values, contact, static):
        if static:
            return 1.0
        speed = np.maximum(recorded(contact.speed_m_s, REFERENCE_SPEED_M_S), 1e-9)
        return 1.0 + values["rate"] * np.log10(speed / REFERENCE_SPEED_M_S)


MECHANISM = Rate(
    "rate",
    "kinetic friction changes with the speed of sliding",
    (Parameter("rate", "1/decade", 0.0, 0.05, -0.9, 0.9),),
    needs=("speed_m_s",),
)
