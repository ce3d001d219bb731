"""Start of the stage, found in the frames: the clamps descend as in the protocol.

In the upright plane through the clamps the strip of cloth under them moves down by the travelled
distance, which is known over time. Each frame is matched with one from before; where the cloth has
sunk far enough, the instant of the start is fitted to all displacements around, to a fraction of
the time between two frames.
"""

import contextlib
import functools
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import islice

import cv2
import numpy as np
from scipy.optimize import least_squares

from slipstitch.base.errors import BadInput
from slipstitch.design.stage_path import StagePath
from slipstitch.film.frame_schedule import Schedule
from slipstitch.film.recording import GIVE_RATE, Moment, Recording
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
# A start is found to 0.03 s. In the example that ships, one stated this much too early or too late
# moves friction by its error bar or little more, one 0.45 s too early by four times as much.
_NEAR_START_S = 0.2
# By how much slow motion is slowed down.
_SLOWED = (2, 4, 8, 16)
# A frame is a repeat of the one before if it differs by less than this share of what frames differ
# by; so many of them, in so many frames, are no accident.
_REPEAT_SHARE, _LEAST_REPEATS, _FRAMES_COMPARED = 0.2, 0.12, 120
# Frames a second of a camera that films a bench.
_SLOWEST_HZ, _FASTEST_HZ = 1.0, 2000.0
_GIVE_START = "--start-s, or start_s in a captures table"


@dataclass(frozen=True)
class StageStart:
    """The start of the stage's motion."""

    time_s: float  # in the video's time
    found: bool  # whether it was found in the frames; else it was stated
    # of the stage, in units of the protocol's; 1 but for a wrong frame rate or stage
    speed: float | None = None
    residual_m: float | None = None  # root mean square of what the fit leaves over

    @property
    def speed_is_right(self) -> bool:
        """Whether the stage moves as fast as the protocol says."""
        return self.speed is None or abs(self.speed - 1) <= _SPEED_TOLERANCE


class _Strip:
    """The upright plane around the clamps as a small metric image, row 0 on top."""

    def __init__(
        self, lens: Camera, schedule: Schedule, half_width_m: float, above_m: float, below_m: float
    ):
        height = schedule.path.start_height_m
        clamps = np.array([[0.0, 0.0, height], [0.0, 0.0, height - 0.01]])
        sinking = float(np.linalg.norm(np.diff(lens.project(clamps), axis=0)))
        self.pixel_m = max(0.01 / max(sinking, 1.0) / _OVERSAMPLING, _FINEST_M)
        top, bottom = height + above_m + _UP_M, height - below_m - _DOWN_M
        rows = round((top - bottom) / self.pixel_m)
        half = round((half_width_m + _ASIDE_M) / self.pixel_m)
        row, column = np.mgrid[:rows, : 2 * half + 1]
        sideways = (column - half) * self.pixel_m
        points = in_stage_plane(schedule.crop(0.0), sideways, top - row * self.pixel_m)
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


def find_start(moments: Iterable[Moment], lens: Camera, schedule: Schedule) -> StageStart | None:
    """When the stage starts to descend, after 2 s at rest at least; None if it never does."""
    search = Search(lens, schedule)
    for moment in moments:
        if search.add(moment.time_s, moment.image):
            break
    return search.start


class Search:
    """A search for the start of the stage's motion, frame by frame; as `find_start`."""

    def __init__(self, lens: Camera, schedule: Schedule):
        strips = (_Strip(lens, schedule, *size) for size in _STRIPS_M)
        self._followers = [_Follower(strip, schedule.path) for strip in strips]
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


def found_start(recording: Recording, lens: Camera, schedule: Schedule) -> StageStart:
    """Return the start of the stage's motion; BadInput, with the likeliest cause, if none."""
    start = find_start(recording.moments(), lens, schedule)
    if start is not None and start.speed_is_right:
        return start
    _check_stated_rate(recording, lens, schedule)
    slowed, from_s, is_turned = _other_start(recording, lens, schedule)
    if is_turned:
        tag = recording.rotation_deg
        said = f" (its orientation tag says {tag} degrees)" if tag else ""
        raise BadInput(
            f"{recording.path}: shows the bench upside down{said}: film, and calibrate the camera, "
            "in the same orientation"
        )
    if start is not None and not slowed:
        from_s = start.time_s
    elif not slowed:
        by_its_times_hz, _ = _rate_and_repeats(recording, 0.0)
        if by_its_times_hz and not _SLOWEST_HZ <= by_its_times_hz <= _FASTEST_HZ:
            raise BadInput(
                f"{recording.path}: {by_its_times_hz:.3g} frames a second by its timestamps, as in "
                f"milliseconds taken for seconds: give the frame rate of the camera ({GIVE_RATE})"
            )
        raise BadInput(
            f"{recording.path}: no start of the stage's motion found: the cloth must hang still "
            f"for 2 s, then descend as in the protocol; if it does, give the start ({_GIVE_START})"
        )
    speed = 1 / slowed if slowed else (start and start.speed) or 0.0
    rate_hz, share = _rate_and_repeats(recording, from_s)
    if share >= _LEAST_REPEATS:
        why = (
            f"; {100 * share:.0f} % of the frames repeat the one before, as where a film was "
            "brought to a constant frame rate: give the film as the camera wrote it"
        )
    elif slowed and recording.frame_rate_hz is None:
        why = (
            f", as in slow motion, filmed at {slowed * rate_hz:.4g} and saved at {rate_hz:.4g} "
            f"frames a second: give the rate at which it was filmed ({GIVE_RATE})"
        )
    else:
        why = f"; if the frame rate is wrong, give the correct one ({GIVE_RATE})"
    raise BadInput(
        f"{recording.path}: the stage descends {speed:.2f} times as fast as in the protocol{why}"
    )


def _check_stated_rate(recording: Recording, lens: Camera, schedule: Schedule) -> None:
    """Refuse a stated frame rate where the film's own times are right."""
    if recording.frame_rate_hz is None:
        return
    by_itself = Recording(recording.path)
    own = None
    with contextlib.suppress(BadInput):  # its times are none, or start again
        own = find_start(by_itself.moments(), lens, schedule)
    if own is not None and own.speed_is_right:
        _, share = _rate_and_repeats(by_itself, own.time_s)
        why = ", in which frames are repeated" if share >= _LEAST_REPEATS else ""
        raise BadInput(
            f"{recording.path}: at {recording.frame_rate_hz:g} frames a second the stage does not "
            f"move as in the protocol; by the film's own times{why}, it does: leave the frame rate "
            "out"
        )


def _other_start(recording: Recording, lens: Camera, schedule: Schedule) -> tuple[int, float, bool]:
    """How many times slower a start is seen (0: not), when, and whether upside down."""
    slowed = {factor: Search(lens, schedule) for factor in _SLOWED}
    turned = Search(lens, schedule)
    for moment in recording.moments():
        for factor, search in slowed.items():
            is_over = search.add(moment.time_s / factor, moment.image)
            if is_over and search.start and search.start.speed_is_right:
                return factor, factor * search.start.time_s, False
        is_over = turned.add(moment.time_s, functools.partial(_upside_down, moment))
        if is_over and turned.start and turned.start.speed_is_right:
            return 0, turned.start.time_s, True
    return 0, 0.0, False


def _upside_down(moment: Moment) -> np.ndarray:
    return cv2.rotate(moment.image(), cv2.ROTATE_180)


def _rate_and_repeats(recording: Recording, from_s: float) -> tuple[float, float]:
    """Frame rate from a time on, and share of frames that show what the one before shows."""
    later = (moment for moment in recording.moments() if moment.time_s >= from_s)
    times_s, small = [], []
    for moment in islice(later, _FRAMES_COMPARED):
        times_s.append(moment.time_s)
        image = cv2.resize(moment.image(), (96, 72), interpolation=cv2.INTER_AREA)
        small.append(image.astype(np.float32))
    if len(small) < 2:
        return 0.0, 0.0
    differ = np.abs(np.diff(small, axis=0)).mean(axis=(1, 2, 3))
    repeated = differ < _REPEAT_SHARE * np.percentile(differ, 90)
    return 1 / float(np.median(np.diff(times_s))), float(repeated.mean())


def start_is_seen(recording: Recording, lens: Camera, schedule: Schedule, start_s: float) -> bool:
    """Return whether the stage starts, perhaps again, where stated; BadInput if elsewhere."""
    moments, seen_s = recording.moments(), []
    while found := find_start(moments, lens, schedule):
        if found.speed_is_right:
            seen_s.append(found.time_s)
        if found.time_s > start_s:
            break
    if not seen_s:
        return False
    nearest_s = min(seen_s, key=lambda time_s: abs(time_s - start_s))
    if abs(nearest_s - start_s) > _NEAR_START_S:
        raise BadInput(
            f"{recording.path}: the stage is seen to start at {nearest_s:.2f} s, but {start_s:.2f} "
            f"s is stated; at most {_NEAR_START_S:g} s difference is allowed: leave the start out"
        )
    return True
