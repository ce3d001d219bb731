"""Anisotropy: friction differs between warp and weft."""

import numpy as np

from slipstitch.friction_law.mechanism import ContactMechanism, Parameter, recorded


class Anisotropy(ContactMechanism):
    """Factor 1 + a cos 2 phi, the same forth and back."""

    def factor(self, values, contact, static):
        direction = recorded(contact.direction_rad, np.pi / 4)
        return 1.0 + values["anisotropy"] * np.cos(2.0 * direction)


MECHANISM = Anisotropy(
    "anisotropy",
    "friction along the warp differs from friction along the weft",
    (Parameter("anisotropy", "1", 0.0, 0.05, -0.9, 0.9),),
    needs=("direction_rad",),
)
