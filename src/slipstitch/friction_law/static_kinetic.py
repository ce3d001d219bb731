"""Static friction above kinetic friction."""

from slipstitch.friction_law.mechanism import ContactMechanism, Parameter


class StaticKinetic(ContactMechanism):
    """Factor 1 + e on the friction at rest."""

    def factor(self, values, contact, static):
        return 1.0 + values["static_kinetic"] if static else 1.0


MECHANISM = StaticKinetic(
    "static_kinetic",
    "static friction exceeds kinetic friction",
    (Parameter("static_kinetic", "1", 0.0, 0.1, 0.0, 3.0),),
)
