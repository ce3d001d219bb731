"""Start of the stage, found in the frames: the clamps descend as in the protocol.

In the upright plane through the clamps the strip of cloth under them moves down by the travelled
distance, which is known over time. Each frame is matched with one from before; where the cloth has
sunk far enough, the instant of the start is fitted to all displacements around, to a fraction of
the time between two frames.
"""

from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.optimize import least_squares

from slipstitch.design.stage_path import StagePath
from slipstitch.film.recording import Moment
from slipstitch.images.camera import Camera
from slipstitch.images.rectification import in_stage_plane

# The strips that are followed, in the upright plane: half their width, and how far they reach above
# and below the clamps. The first has the cloth's upper edge in it, which is all that shows how a
# plain cloth moves; but where the floor's edge is seen beside or above the cloth, it stands still
# and outweighs the cloth. The second lies within the cloth.
_STRIPS_M = ((0.10, 0.008, 0.060), (0.065, -0.010, 0.070))
# How far it is looked for: up and down, and to the sides (the bench is not perfectly aligned).
_UP_M, _DOWN_M, _ASIDE_M = 0.006, 0.030, 0.004
_FINEST_M = 0.0004
# A parabola tells fractions of a pixel only where the match is smooth over several.
_OVERSAMPLING = 3
# Frames are compared with those this much earlier, at this rate at most.
_LAG_S = 2.5
_TEMPLATE_S = 0.5
_RATE_HZ = 15.0
# A candidate: sunk by this much in the lag. Fitted until this much later.
_SUNK_M = 0.010
_LATER_S = 0.8
_LEAST_LIKENESS = 0.5
# Matches scatter by 0.1 mm and less; a hand in the image does not move like a stage.
_LARGEST_RESIDUAL_M = 0.0008
_SPEED_RANGE = (0.3, 3.0)
_SPEED_TOLERANCE = 0.08


@dataclass(frozen=True)
class StageStart:
    """The start of the stage's motion.

    Attributes
    ----------
    time_s : float
        In the video's time.
    found : bool
        Whether it was found in the frames; else it was stated.
    speed : float, optional
        Of the stage, in units of the protocol's; 1 but for a wrong frame rate or stage.
    residual_m : float, optional
        Root mean square of what the fit leaves over.
    """

    time_s: float
    found: bool
    speed: float | None = None
    residual_m: float | None = None

    @property
    def speed_is_right(self) -> bool:
        """Whether the stage moves as fast as the protocol says."""
        return self.speed is None or abs(self.speed - 1) <= _SPEED_TOLERANCE


class _Strip:
    """The upright plane around the clamps as a small metric image, row 0 on top."""

    def __init__(
        self,
        lens: Camera,
        crop: Camera,
        path: StagePath,
        half_width_m: float,
        above_m: float,
        below_m: float,
    ):
        height = path.start_height_m
        clamps = np.array([[0.0, 0.0, height], [0.0, 0.0, height - 0.01]])
        sinking = float(np.linalg.norm(np.diff(lens.project(clamps), axis=0)))
        self.pixel_m = max(0.01 / max(sinking, 1.0) / _OVERSAMPLING, _FINEST_M)
        top, bottom = height + above_m + _UP_M, height - below_m - _DOWN_M
        rows = round((top - bottom) / self.pixel_m)
        half = round((half_width_m + _ASIDE_M) / self.pixel_m)
        row, column = np.mgrid[:rows, : 2 * half + 1]
        sideways = (column - half) * self.pixel_m
        points = in_stage_plane(crop, sideways, top - row * self.pixel_m)
        place = lens.project(points.reshape(-1, 3)).reshape(rows, 2 * half + 1, 2)
        self.map = place.astype(np.float32)
        self.up, self.aside = round(_UP_M / self.pixel_m), round(_ASIDE_M / self.pixel_m)
        self.rows = round((above_m + below_m) / self.pixel_m)

    def cut(self, image: np.ndarray) -> np.ndarray:
        """The strip of an image, grey float32."""
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        strip = cv2.remap(grey, self.map, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return cv2.GaussianBlur(strip, (0, 0), 0.8).astype(np.float32)

    def template(self, strip: np.ndarray) -> np.ndarray:
        """The part that is looked for in later strips."""
        return strip[self.up : self.up + self.rows, self.aside : -self.aside or None]

    def sunk(self, strip: np.ndarray, template: np.ndarray) -> tuple[float, float]:
        """By how much (m) the template lies lower in a strip, and how alike it is there (0 ... 1).

        The brightness does not matter (normalised cross-correlation); a parabola through the
        best match and its neighbours gives the fraction of a pixel.
        """
        likeness = cv2.matchTemplate(strip, template, cv2.TM_CCOEFF_NORMED)
        _, best, _, (x, y) = cv2.minMaxLoc(likeness)
        shift = 0.0
        if 0 < y < len(likeness) - 1:
            shift = float(vertex_of_parabola(*likeness[y - 1 : y + 2, x]))
        return (y + shift - self.up) * self.pixel_m, float(best)


def vertex_of_parabola(before: np.ndarray, at: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Where a parabola through three neighbours peaks, from the middle one; 0 if it does not."""
    curvature = before - 2 * at + after
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(curvature < 0, 0.5 * (before - after) / curvature, 0.0)


def find_start(
    moments: Iterable[Moment], lens: Camera, crop: Camera, path: StagePath
) -> StageStart | None:
    """Time at which the stage starts to descend; None if it never does.

    Parameters
    ----------
    moments : iterable of Moment
        Frames of a video in which the cloth hangs still for 2 s at least before the start. No more
        than some seconds of small images are kept.
    lens : Camera
        The real camera.
    crop : Camera
        Of the calibrated viewpoint at the start.
    path : StagePath
    """
    search = Search(lens, crop, path)
    for moment in moments:
        if search.add(moment.time_s, moment.image):
            break
    return search.start


class Search:
    """A search for the start of the stage's motion, frame by frame.

    Parameters
    ----------
    lens, crop, path
        As for `find_start`.
    """

    def __init__(self, lens: Camera, crop: Camera, path: StagePath):
        self._followers = [_Follower(_Strip(lens, crop, path, *size), path) for size in _STRIPS_M]
        self._last_s = -np.inf

    def add(self, time_s: float, image: Callable[[], np.ndarray]) -> bool:
        """Look at a frame at a time, if one is due; return whether the search is over."""
        if time_s - self._last_s < 1 / _RATE_HZ - 1e-3:
            return False
        self._last_s, seen = time_s, image()
        for follower in self._followers:
            follower.follow(time_s, seen)
        starts_s = [one.start.time_s for one in self._followers if one.start]
        if starts_s and time_s - min(starts_s) > 2 * (_LAG_S + _LATER_S):
            return True
        first = self._followers[0].start
        return first is not None and first.speed_is_right

    @property
    def start(self) -> StageStart | None:
        """What was found so far."""
        starts = [one.start for one in self._followers if one.start]
        # What stands still slows a strip down: one that moves as the stage does is believed first.
        return next((one for one in starts if one.speed_is_right), starts[0] if starts else None)


class _Follower:
    """Follows one strip from frame to frame until it has sunk as the stage does."""

    def __init__(self, strip: _Strip, path: StagePath):
        self._strip, self._path = strip, path
        self._kept: deque[tuple[float, np.ndarray]] = deque()
        self._candidate_s: float | None = None
        self.start: StageStart | None = None

    def follow(self, time_s: float, image: np.ndarray) -> None:
        """Take one more frame, until the start is found."""
        if self.start is not None:
            return
        kept, strip = self._kept, self._strip
        kept.append((time_s, strip.cut(image)))
        while time_s - kept[0][0] > _LAG_S + _TEMPLATE_S + _LATER_S:
            kept.popleft()
        if self._candidate_s is None:
            before = [one for earlier_s, one in kept if time_s - earlier_s >= _LAG_S]
            if before:
                down_m, likeness = strip.sunk(kept[-1][1], strip.template(before[-1]))
                if down_m > _SUNK_M and likeness > _LEAST_LIKENESS:
                    self._candidate_s = time_s
        elif time_s - self._candidate_s >= _LATER_S:
            self.start = _fit(list(kept), strip, self._candidate_s, self._path)
            self._candidate_s = None


def _fit(
    kept: list[tuple[float, np.ndarray]], strip: _Strip, candidate_s: float, path: StagePath
) -> StageStart | None:
    """The start that explains how the strip sinks around a candidate; None if none does."""
    still_until = candidate_s - _LAG_S
    still = [image for time_s, image in kept if time_s <= still_until + 1e-6]
    if not still:
        return None
    template = strip.template(np.mean(still, axis=0, dtype=np.float32))
    later = [
        (time_s, *strip.sunk(image, template)) for time_s, image in kept if time_s > still_until
    ]
    time_s, down_m, likeness = np.array(later).T
    if likeness.min() < _LEAST_LIKENESS or len(later) < 8:
        return None

    def left_over_mm(parameters: np.ndarray) -> np.ndarray:
        start_s, speed = parameters
        _, height_m = path.position_m(speed * (time_s - start_s))
        return (path.start_height_m - height_m - down_m) * 1e3

    bounds = ([still_until, _SPEED_RANGE[0]], [candidate_s, _SPEED_RANGE[1]])
    robust = {"loss": "soft_l1", "f_scale": 0.3}
    fitted = least_squares(left_over_mm, [candidate_s - 1.5, 1.0], bounds=bounds, **robust)
    residual_m = float(np.sqrt(np.mean(left_over_mm(fitted.x) ** 2))) * 1e-3
    start_s, speed = map(float, fitted.x)
    if residual_m > _LARGEST_RESIDUAL_M:
        return None
    start = StageStart(start_s, True, speed, residual_m)
    if not start.speed_is_right:
        return start
    # At the right speed the instant is told more sharply.
    fixed = least_squares(lambda one: left_over_mm(np.array([one[0], 1.0])), [start_s], **robust)
    return StageStart(float(fixed.x[0]), True, speed, residual_m)
