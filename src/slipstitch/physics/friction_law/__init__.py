"""The friction law as an object, shared by the simulator, the protocols and the fits.

Depends on numpy alone. A further mechanism is one entry of the table in ``mechanisms.py``.
"""

from slipstitch.physics.friction_law.contact import Contact
from slipstitch.physics.friction_law.curve import Curve
from slipstitch.physics.friction_law.law import FrictionLaw
from slipstitch.physics.friction_law.mechanism import ContactMechanism, Mechanism, Parameter
from slipstitch.physics.friction_law.mechanisms import CONTACT_MECHANISMS

__all__ = [
    "CONTACT_MECHANISMS",
    "Contact",
    "ContactMechanism",
    "Curve",
    "FrictionLaw",
    "Mechanism",
    "Parameter",
]
