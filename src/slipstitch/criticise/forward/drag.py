"""(c) Flat drag: what a force cell reads while a spring pulls a loaded piece of cloth."""

from __future__ import annotations

import numpy as np

from slipstitch.criticise.forward.bench import Bench
from slipstitch.friction_law import Contact, FrictionLaw


def cell_reading(
    law: FrictionLaw,
    contact: Contact,
    static: bool,
    direction: float,
    tilt_downhill_rad: np.ndarray | float,
    bench: Bench,
) -> np.ndarray:
    """Cell reading while sliding (or at the point of slip), ``direction`` +1 or -1.

    ``(1 + gain)(direction F - N sin tilt) + offset``, tilt positive where stage +x runs downhill.
    """
    friction = law.force_limit(contact, static)
    along = direction * friction - np.asarray(contact.normal_force_N) * np.sin(tilt_downhill_rad)
    return (1.0 + bench.force_gain) * along + bench.force_offset_N
