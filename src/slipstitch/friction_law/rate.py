"""Rate: kinetic friction changes with the logarithm of the speed."""

import numpy as np

from slipstitch.friction_law.contact import REFERENCE_SPEED_M_S
from slipstitch.friction_law.mechanism import ContactMechanism, Parameter

# Below, the logarithm is cut off: a node's elastic microslip over a time step is of this size.
SLOWEST_M_S = 1.0e-5


def kinetic_factor(rate, speed_m_s):
    """1 + b log10(v / 10 mm/s)."""
    return 1.0 + rate * np.log10(np.maximum(speed_m_s, SLOWEST_M_S) / REFERENCE_SPEED_M_S)


MECHANISM = ContactMechanism(
    "rate",
    "kinetic friction changes with the speed of sliding",
    (Parameter("rate", "1/decade", 0.0, 0.05, -0.9, 0.9),),
    needs=("speed_m_s",),
    kinetic_factor=kinetic_factor,
    unrecorded={"speed_m_s": REFERENCE_SPEED_M_S},
)
