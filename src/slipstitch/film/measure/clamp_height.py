"""A reading corrected for clamps that hang higher or lower than the protocol says."""

import math
from dataclasses import dataclass, replace

import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.learning.instrument.measuring import HALF_WIDTH
from slipstitch.learning.prediction import Prediction

# Relative change of what the instrument that comes with Slipstitch reads, per metre that the clamps
# hang higher, and its standard error: results/published/camera/clamp_height.json, of 32 simulations
# at coefficients from 0.5 to 1.25 and heights of 0.9 mm standard deviation.
READING_PER_M, READING_PER_M_SD = -68.4, 17.8
FURTHEST_M = 0.002
GAUGE_BLOCK_M = 0.0002
#: Of the heights that the instrument's intervals allow for, and up to which it learnt.
ASSUMED_M = 0.001
# A film that states a larger error corrects nothing. Of rendered films (studies/clamp_height.py),
# such were the wrong ones: a dark cloth before a dark background.
EXACT_M = 0.0006


@dataclass(frozen=True)
class ClampHeight:
    """Height of the lowered clamps above the substrate, as it was measured."""

    height_m: float
    error_m: float  # standard deviation
    protocol_m: float  # what the protocol says
    source: str = "told"  # who measured it

    def __post_init__(self):
        within = [1e3 * (self.protocol_m + sign * FURTHEST_M) for sign in (-1, 1)]
        if not abs(self.height_m - self.protocol_m) <= FURTHEST_M + 1e-9:
            raise BadInput(
                f"clamp height {1e3 * self.height_m:g} mm: must be from {within[0]:g} to "
                f"{within[1]:g} mm, where its effect was measured"
            )
        if not 0 < self.error_m <= FURTHEST_M:
            raise BadInput(
                f"error of the clamp height {1e3 * self.error_m:g} mm: must be above 0 and at most "
                f"{1e3 * FURTHEST_M:g} mm"
            )

    def __str__(self) -> str:
        return f"{1e3 * self.height_m:g} ± {1e3 * self.error_m:g} mm, {self.source}"

    @property
    def factor(self) -> float:
        """Coefficient over reading."""
        return 1 / (1 + READING_PER_M * (self.height_m - self.protocol_m))

    @property
    def relative_error(self) -> float:
        """Standard deviation of the factor, over the factor: of the height and of its effect."""
        away_m = self.height_m - self.protocol_m
        return self.factor * math.hypot(READING_PER_M * self.error_m, READING_PER_M_SD * away_m)

    def corrected(self, read: Prediction) -> Prediction:
        """The prediction at the true height: median, interval and distribution.

        The errors of height and effect are added to the interval's, which holds for clamps within
        1 mm of the protocol that nobody measured: it becomes no narrower.
        """
        grid, probability = map(np.asarray, read.distribution)
        median = min(self.factor * read.friction_coefficient, float(grid[-1]))
        ends, interval = grid[[0, -1]], np.asarray(read.interval_90)
        halves = np.hypot(
            self.factor * (interval - read.friction_coefficient),
            HALF_WIDTH * self.relative_error * median,
        )
        moved = np.clip(median + halves * [-1, 1], *ends)
        low, high = np.where(interval == ends, ends, moved)
        centre = self.factor * grid
        spread = np.maximum(self.relative_error * centre, np.diff(grid).min() / 2)
        share = np.exp(-0.5 * ((grid[:, None] - centre) / spread) ** 2) + 1e-300
        return replace(
            read,
            friction_coefficient=median,
            interval_90=(float(low), float(high)),
            distribution=(grid, (share / share.sum(axis=0)) @ probability),
        )

    def note(self, corrected: float) -> str:
        """What the height does to a corrected coefficient, for the person who reads it."""
        return (
            f"clamps at {self}, {1e3 * (self.height_m - self.protocol_m):+.2g} mm from the "
            f"protocol: the reading {corrected / self.factor:.3f} is corrected by "
            f"{100 * (self.factor - 1):+.1f} %, which adds ± "
            f"{self.relative_error * corrected:.3f} to its error; measured for coefficients from "
            "0.5 to 1.25"
        )


def told_height(
    height_mm: float | None, error_mm: float | None, protocol_m: float, is_shipped: bool
) -> ClampHeight | None:
    """Return the height as told, None if it was not; BadInput if it cannot be used.

    Without an error, that of a gauge block. Its effect is known of the shipped instrument alone.
    """
    if height_mm is None:
        if error_mm is not None:
            raise BadInput("error of the clamp height: give the clamp height with it")
        return None
    if not is_shipped:
        raise BadInput(
            "clamp height: its effect was measured for the instrument that comes with Slipstitch, "
            "not for another"
        )
    error_m = GAUGE_BLOCK_M if error_mm is None else 1e-3 * error_mm
    return ClampHeight(1e-3 * height_mm, error_m, protocol_m)


@dataclass(frozen=True)
class SeenClamps:
    """Height of the lowered clamps as a film shows it, with standard deviations."""

    height_m: float
    of_image_m: float  # of the edge in the image
    of_camera_m: float
    protocol_m: float

    def __str__(self) -> str:
        return f"{1e3 * self.height_m:.1f} ± {1e3 * self.error_m:.1f} mm ({self._parts})"

    @property
    def _parts(self) -> str:
        return f"image ± {1e3 * self.of_image_m:.1f}, camera ± {1e3 * self.of_camera_m:.1f} mm"

    @property
    def error_m(self) -> float:
        """Of the whole."""
        return math.hypot(self.of_image_m, self.of_camera_m)

    @property
    def is_exact(self) -> bool:
        """Whether the film tells more than is assumed of every bench."""
        return self.error_m < EXACT_M

    @property
    def is_too_far(self) -> bool:
        """Whether the clamps hang where nobody knows what the instrument reads."""
        return self.is_exact and abs(self.height_m - self.protocol_m) > FURTHEST_M

    def measured(self) -> ClampHeight | None:
        """What corrects a reading; None where the film tells too little, or they are too far."""
        if not self.is_exact or self.is_too_far:
            return None
        height_m, error_m = round(self.height_m, 5), round(self.error_m, 5)
        source = f"measured from the film ({self._parts})"
        return ClampHeight(height_m, error_m, self.protocol_m, source)

    def contradiction(self, told: ClampHeight | None) -> str:
        """What is to be said of a height that the film contradicts; empty where it does not."""
        height_m, error_m = (told.height_m, told.error_m) if told else (self.protocol_m, 0.0)
        away_m = self.height_m - height_m
        if abs(away_m) <= 2 * math.hypot(self.error_m, error_m):
            return ""
        return (
            f"in the film the clamps are seen at {self}, {1e3 * away_m:+.1f} mm from the height "
            f"{'told' if told else 'of the protocol'}: measure it with a gauge block, "
            "and how thick the calibration board is"
        )
