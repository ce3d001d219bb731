"""Nap: friction differs with and against the warp direction."""

import numpy as np

from slipstitch.friction_law.mechanism import ContactMechanism, Parameter, recorded


class Nap(ContactMechanism):
    """Factor 1 + a cos phi: sliding back has the other sign."""

    def factor(self, values, contact, static):
        direction = recorded(contact.direction_rad, np.pi / 2)
        return 1.0 + values["nap"] * np.cos(direction)


MECHANISM = Nap(
    "nap",
    "friction with the nap differs from friction against it",
    (Parameter("nap", "1", 0.0, 0.05, -0.9, 0.9),),
    needs=("direction_rad",),
)
