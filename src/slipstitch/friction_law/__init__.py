"""The friction law as an object, shared by the simulator, the protocols and the fits.

Depends on numpy alone. A further mechanism is one file like ``ageing.py`` and its module's name in
``law.CONTACT_MECHANISMS``: protocols and fits evaluate its formula with NumPy, and the cloth
simulator evaluates a translation of the same source (:mod:`slipstitch.cloth.friction`).
"""

from slipstitch.friction_law.contact import Contact
from slipstitch.friction_law.law import CONTACT_MECHANISMS, FrictionLaw
from slipstitch.friction_law.mechanism import ContactMechanism, Mechanism, Parameter

__all__ = [
    "CONTACT_MECHANISMS",
    "Contact",
    "ContactMechanism",
    "FrictionLaw",
    "Mechanism",
    "Parameter",
]
