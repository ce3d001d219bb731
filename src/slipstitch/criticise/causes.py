"""What may be wrong: every mechanism that a verdict can name, and the sensors themselves.

Mechanisms are those of the contact, then those of bench and fabric. A further one of bench or
fabric is one entry of the table below; a protocol that reads a new field of :class:`Bench` lists it
in its ``READS``. One of the contact goes into the table of
:mod:`slipstitch.physics.friction_law.mechanisms`.

A zero or a delay that is off is no mechanism: it is estimated beside every model with a prior, and
what is clearly wrong is a finding about the data, neither a cause nor a reason for `unknown`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field

from slipstitch.physics.friction_law import CONTACT_MECHANISMS, Mechanism, Parameter

DEGREE = math.pi / 180


@dataclass(frozen=True)
class Bench:
    """Departures of the instrument and of the fabric; the defaults are the nominal ones.

    ``tilt_along_rad`` and ``tilt_across_rad`` are the components of the floor's slope towards lab
    azimuth 0 and 90 degrees (positive: it falls that way). ``backlash_m`` is motion lost after the
    reversal; the frame at time t shows the cloth as it was ``time_lag_s`` before; a camera reads
    the true length times ``camera_scale``, a force cell (1 + ``force_gain``) times the force, and
    ``force_offset_N`` more.

    The zeros are of sensors alone and no mechanisms (:mod:`slipstitch.criticise.causes`): the
    stage starts ``stage_zero_m`` late and turns ``turn_early_m`` early; a delay is that of a
    reading behind its stage, a drift is counted from the middle of the session; readings are too
    large by the others. ``track_drop`` are the drops that an uneven track makes where nothing
    sticks, in units of those that its unevenness would allow, ``damping`` the ratio of a slider on
    its spring.
    """

    mass_error: float = 0.0
    bending_error: float = 0.0
    tilt_along_rad: float = 0.0
    tilt_across_rad: float = 0.0
    backlash_m: float = 0.0
    camera_scale: float = 1.0
    force_offset_N: float = 0.0
    force_gain: float = 0.0
    time_lag_s: float = 0.0
    angle_zero_rad: float = 0.0
    strain_zero: float = 0.0
    stage_zero_m: float = 0.0
    turn_early_m: float = 0.0
    edge_zero_m: float = 0.0
    contact_zero_m: float = 0.0
    contact_scale_error: float = 0.0
    contact_delay_s: float = 0.0
    force_delay_s: float = 0.0
    force_drift_N_h: float = 0.0
    track_drop: float = 0.0
    damping: float = 0.0


@dataclass(frozen=True)
class BenchParameter(Parameter):
    """A parameter that sets a field of :class:`Bench`: ``to_si`` times its value."""

    sets: str = field(kw_only=True)
    to_si: float = field(default=1.0, kw_only=True)


class BenchMechanism(Mechanism):
    """A mechanism that changes the bench or the fabric, not the contact."""

    parameters: tuple[BenchParameter, ...]

    def changes(self, values: Mapping[str, float]) -> dict[str, float]:
        """Fields of :class:`Bench` that the parameter values set."""
        return {p.sets: p.to_si * values[p.name] for p in self.parameters}


def _error(name: str, scale: float, lower: float, upper: float) -> tuple[BenchParameter]:
    """Of a nominal value: true = nominal (1 + error)."""
    return (BenchParameter(name, "1", 0.0, scale, lower, upper, relative=True, sets=name),)


_ENTRIES = (
    BenchMechanism(
        "tilt",
        "the floor is tilted",
        # Two components, so that no tilt is a regular point.
        tuple(
            BenchParameter(
                f"tilt_{way}", "deg", 0.0, 0.3, -20.0, 20.0, sets=f"tilt_{way}_rad", to_si=DEGREE
            )
            for way in ("along", "across")
        ),
        covariate="azimuth_deg",
        components=("tilt", "tilt_azimuth"),
        direct_check=(
            "a level on the floor along azimuths 0 and 90",
            {"tilt_along": 0.05, "tilt_across": 0.05},
        ),
    ),
    BenchMechanism(
        "mass_error",
        "the cloth is heavier (or lighter) than its nominal mass",
        _error("mass_error", 0.05, -0.6, 2.0),
        direct_check=("weigh a cut of known area", {"mass_error": 0.01}),
    ),
    BenchMechanism(
        "bending_error",  # of the sheet and of the strip
        "the cloth is stiffer (or softer) than its nominal bending stiffness",
        _error("bending_error", 0.1, -0.9, 8.0),
        direct_check=("cantilever test of the fabric's stiffness", {"bending_error": 0.05}),
    ),
    BenchMechanism(
        "backlash",
        "the stage loses motion at the reversal",
        (BenchParameter("backlash", "mm", 0.0, 0.2, 0.0, 20.0, sets="backlash_m", to_si=1e-3),),
        direct_check=("a dial gauge on the stage at the reversal", {"backlash": 0.02}),
    ),
    BenchMechanism(
        "camera_scale",
        "the camera's scale is off",
        (BenchParameter("camera_scale", "1", 1.0, 0.02, 0.5, 2.0, sets="camera_scale"),),
        direct_check=("a ruler in the camera's view", {"camera_scale": 0.002}),
    ),
    BenchMechanism(
        "force_offset",
        "the force cell has an offset",
        (
            BenchParameter(
                "force_offset", "mN", 0.0, 0.5, -500.0, 500.0, sets="force_offset_N", to_si=1e-3
            ),
        ),
        direct_check=("known weights on the force cell", {"force_offset": 0.1}),
    ),
    BenchMechanism(
        "force_gain",
        "the force cell has a wrong gain",
        _error("force_gain", 0.03, -0.6, 2.0),
        direct_check=("known weights on the force cell", {"force_gain": 0.005}),
    ),
    BenchMechanism(
        "time_lag",
        "the camera lags behind the stage's clock",
        (BenchParameter("time_lag", "s", 0.0, 0.1, -2.0, 10.0, sets="time_lag_s"),),
        covariate="speed_mm_s",
        direct_check=("a flash seen by camera and stage clock", {"time_lag": 0.02}),
    ),
)
BENCH_MECHANISMS: Mapping[str, BenchMechanism] = {m.identifier: m for m in _ENTRIES}
MECHANISMS: Mapping[str, Mechanism] = {**CONTACT_MECHANISMS, **BENCH_MECHANISMS}


def departures(
    causes: Iterable[str], values: Mapping[str, float]
) -> tuple[dict[str, dict[str, float]], dict[str, float]]:
    """Mechanisms of the friction law, and fields of :class:`Bench`, at values of parameters."""
    mechanisms: dict[str, dict[str, float]] = {}
    changes: dict[str, float] = {}
    for cause in causes:
        own = {p.name: values[p.name] for p in MECHANISMS[cause].parameters}
        if cause in CONTACT_MECHANISMS:
            mechanisms[cause] = own
        else:
            changes |= BENCH_MECHANISMS[cause].changes(own)
    return mechanisms, changes


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


_ZEROS = (
    Zero("angle_zero_rad", "protractor", "zero of the angle", "deg", DEGREE, 0.5),
    Zero("strain_zero", "strain camera", "zero of the strain", "1", 1.0, 0.005),
    Zero("stage_zero_m", "stage", "start of the stage", "mm", 1e-3, 1.5),
    Zero("force_delay_s", "force cell", "delay of the force", "s", 1.0, 0.05),
    Zero("force_drift_N_h", "force cell", "drift of the force", "mN/h", 1e-3, 2.0),
    Zero("turn_early_m", "stage", "place of the turn", "mm", 1e-3, 2.0),
    Zero("edge_zero_m", "edge camera", "zero of the trailing edge", "mm", 1e-3, 0.5),
    Zero("contact_zero_m", "contact camera", "zero of the contact length", "mm", 1e-3, 3.0),
    # As well as a ruler in a picture tells.
    Zero("contact_scale_error", "contact camera", "scale of the contact length", "1", 1.0, 0.03),
    Zero("contact_delay_s", "contact camera", "delay of the contact length", "s", 1.0, 0.2),
    # Of the critical: a few per cent, as in dry joints and springs.
    Zero("damping", "slider", "damping ratio", "1", 1.0, 0.03, of_sensor=False),
    # What the reading of the turn leaves where no motion is lost: benchmark's null data, seeds
    # 430000 to 430203 (28 campaigns), have 0.007 mm, and the extraction states half of that.
    Zero("backlash_m", "stage", "resolution of the turn", "mm", 1e-3, 0.01, of_sensor=False),
    # The half drop of a wave is 1.4 times the standard deviation that it has.
    Zero("track_drop", "track", "drops of an uneven track", "1", 1.0, 1.4, of_sensor=False),
)
ZEROS: Mapping[str, Zero] = {zero.field: zero for zero in _ZEROS}


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
