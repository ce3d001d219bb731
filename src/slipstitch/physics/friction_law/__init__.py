"""The friction law as an object, shared by the simulator, the protocols and the fits.

Depends on numpy alone. A further mechanism is one entry of the table in ``mechanisms.py``.
"""

from slipstitch.physics.friction_law.law import Curve, FrictionLaw
from slipstitch.physics.friction_law.mechanisms import (
    CONTACT_MECHANISMS,
    Contact,
    ContactMechanism,
    Mechanism,
    Parameter,
)
