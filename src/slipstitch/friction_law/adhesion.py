"""Adhesion: a friction force in proportion to the area, at no load."""

import numpy as np

from slipstitch.friction_law.mechanism import ContactMechanism, Parameter


class Adhesion(ContactMechanism):
    """Adds a shear stress times the apparent area (Bowden and Tabor)."""

    def added_force(self, values, contact, static):
        return values["adhesion"] * np.asarray(contact.area_m2)


MECHANISM = Adhesion(
    "adhesion",
    "friction has a part that grows with the area, not the load",
    (Parameter("adhesion", "Pa", 0.0, 1.0, -30.0, 200.0),),
    needs=("normal_force_N", "area_m2"),
)
