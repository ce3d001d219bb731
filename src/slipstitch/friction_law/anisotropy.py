"""Anisotropy: friction differs between warp and weft."""

import numpy as np

from slipstitch.friction_law.mechanism import ContactMechanism, Parameter


def factor(anisotropy, direction_rad):
    """1 + a cos 2 phi, the same forth and back."""
    return 1.0 + anisotropy * np.cos(2.0 * direction_rad)


MECHANISM = ContactMechanism(
    "anisotropy",
    "friction along the warp differs from friction along the weft",
    (Parameter("anisotropy", "1", 0.0, 0.05, -0.9, 0.9),),
    needs=("direction_rad",),
    factor=factor,
    unrecorded={"direction_rad": np.pi / 4},
)
