"""Adhesion: a friction force in proportion to the area, at no load (Bowden and Tabor)."""

from slipstitch.friction_law.mechanism import ContactMechanism, Parameter


def added_force(adhesion, area_m2):
    """A shear stress times the apparent area."""
    return adhesion * area_m2


MECHANISM = ContactMechanism(
    "adhesion",
    "friction has a part that grows with the area, not the load",
    (Parameter("adhesion", "Pa", 0.0, 1.0, -30.0, 200.0),),
    needs=("normal_force_N", "area_m2"),
    added_force=added_force,
)
