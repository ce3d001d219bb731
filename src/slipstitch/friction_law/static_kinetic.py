"""Static friction above kinetic friction."""

from slipstitch.friction_law.mechanism import ContactMechanism, Parameter


def static_factor(static_kinetic):
    """1 + e."""
    return 1.0 + static_kinetic


MECHANISM = ContactMechanism(
    "static_kinetic",
    "static friction exceeds kinetic friction",
    (Parameter("static_kinetic", "1", 0.0, 0.1, 0.0, 3.0),),
    static_factor=static_factor,
)
