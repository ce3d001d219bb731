"""What may be wrong with a sensor itself: zeros, and noise beyond what is stated.

A zero or a delay that is off is no mechanism: it is estimated beside every model with a prior, and
what is clearly wrong is a finding about the data, neither a cause nor a reason for `unknown`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from types import MappingProxyType


@dataclass(frozen=True)
class Zero:
    """A constant error of a sensor, or one that grows with time or speed.

    Attributes
    ----------
    field : of :class:`slipstitch.criticise.causes.Bench`, which holds it.
    sensor, quantity : as they are said.
    unit, to_si : of the size that is said, and its worth in the unit of the field.
    sd : how large it usually is, in ``unit``.
    of_sensor : not so for what is no sensor's fault but acts like one, and is always allowed for.
    """

    field: str
    sensor: str
    quantity: str
    unit: str
    to_si: float
    sd: float
    of_sensor: bool = True


_ENTRIES = (
    Zero("angle_zero_rad", "protractor", "zero of the angle", "deg", 0.017453292519943295, 0.5),
    Zero("strain_zero", "strain camera", "zero of the strain", "1", 1.0, 0.005),
    Zero("stage_zero_m", "stage", "start of the stage", "mm", 1e-3, 1.5),
    Zero("force_delay_s", "force cell", "delay of the force", "s", 1.0, 0.05),
    Zero("force_drift_N_h", "force cell", "drift of the force", "mN/h", 1e-3, 2.0),
    Zero("turn_early_m", "stage", "place of the turn", "mm", 1e-3, 2.0),
    Zero("edge_zero_m", "edge camera", "zero of the trailing edge", "mm", 1e-3, 0.5),
    Zero("contact_zero_m", "contact camera", "zero of the contact length", "mm", 1e-3, 3.0),
    Zero("contact_delay_s", "contact camera", "delay of the contact length", "s", 1.0, 0.2),
    # Of the critical: a few per cent, as in dry joints and springs.
    Zero("damping", "slider", "damping ratio", "1", 1.0, 0.03, of_sensor=False),
    # What the reading of the turn leaves where no motion is lost: benchmark's null data, seeds
    # 430000 to 430203 (28 campaigns), have 0.007 mm, and the extraction states half of that.
    Zero("backlash_m", "stage", "resolution of the turn", "mm", 1e-3, 0.01, of_sensor=False),
    # The half drop of a wave is 1.4 times the standard deviation that it has.
    Zero("track_drop", "track", "drops of an uneven track", "1", 1.0, 1.4, of_sensor=False),
)
ZEROS: Mapping[str, Zero] = MappingProxyType({zero.field: zero for zero in _ENTRIES})


@dataclass(frozen=True)
class DataFinding:
    """Something clearly wrong with the data of one sensor.

    ``kind`` is ``zero`` (``size`` in ``unit``), ``noise`` (``size`` times what was stated), or, of
    the traces as they were read, ``clock``, ``glitches`` or ``cell``.
    """

    protocol: str
    sensor: str
    quantity: str
    kind: str
    size: float
    ci95: tuple[float, float]
    unit: str

    def as_dict(self) -> dict:
        """As it stands in the verdict."""
        rounded = {
            "size": float(f"{self.size:.4g}"),
            "ci95": [float(f"{end:.4g}") for end in self.ci95],
        }
        return asdict(self) | rounded


def data_words(findings: list[dict]) -> list[str]:
    """Say in a sentence each what was wrong with traces as they were read."""
    return [
        f"In {found['protocol']}, {found['sensor']}: {found['size']:.4g} "
        f"{'' if found['unit'] == '1' else found['unit'] + ' '}{found['quantity']}."
        for found in findings
        if found["kind"] in ("clock", "glitches", "cell")
    ]
