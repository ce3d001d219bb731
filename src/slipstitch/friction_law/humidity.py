"""Humidity: friction changes with the relative humidity of the air."""

from slipstitch.friction_law.contact import REFERENCE_HUMIDITY_PCT
from slipstitch.friction_law.mechanism import ContactMechanism, Parameter


def factor(humidity, relative_humidity_pct):
    """1 + a (RH - 50) / 10."""
    return 1.0 + humidity * (relative_humidity_pct - REFERENCE_HUMIDITY_PCT) / 10.0


MECHANISM = ContactMechanism(
    "humidity",
    "friction changes with the humidity of the air",
    (Parameter("humidity", "1 per 10 % RH", 0.0, 0.05, -0.15, 0.15),),
    needs=("relative_humidity_pct",),
    factor=factor,
    unrecorded={"relative_humidity_pct": REFERENCE_HUMIDITY_PCT},
)
