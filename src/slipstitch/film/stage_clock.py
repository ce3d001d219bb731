"""Verification of a video's clock: the stage's known motion, tracked over the whole video.

A film whose frame rate is stated wrong, or whose stage runs at another speed, shows every moment of
the protocol too early or too late, and friction is then read off the wrong moments. The upper edge
of the cloth moves with the clamps. It is looked for along the track in a frame a second, and the
speed of the stage in the video's time is fitted to all positions found.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.optimize import least_squares

from slipstitch.base.errors import BadInput
from slipstitch.design.stage_path import SIDE_M, StagePath
from slipstitch.film.edge_height import EdgeFinder, cut_out, is_at_rest
from slipstitch.film.frame_schedule import Schedule
from slipstitch.film.recording import GIVE_RATE
from slipstitch.film.stage_start import vertex_of_parabola
from slipstitch.images.camera import Camera
from slipstitch.images.rectification import in_stage_plane

#: Seconds between the frames that are looked at.
INTERVAL_S = 1.0
# So much of it may lie between two frames, if that saves decoding.
_EARLIEST, _LATEST = 0.7, 1.5
# The part of the stage plane that is followed: around the cloth's upper edge, on a grid this fine.
_HALF_WIDTH_M = SIDE_M / 2 + 0.015
_ABOVE_M, _BELOW_M = 0.010, 0.026
_GRID_M = 0.002
# The image is projected at places this far apart, and linear between them (to 0.01 pixels).
_KNOT_M = 0.02
# How far it is looked for: this much, and as far as a clock wrong by this share would put it.
_REACH_M, _REACH_RATE = 0.012, 0.08
_RATES = np.arange(0.93, 1.0701, 0.0005)
# The template is taken from so many frames, where the stage rests between drop and drag.
_REST_FRAMES = 3
# A place counts if the cloth is recognised there, and is near the best path. Dragged cloth leans
# and is little like its edge at rest: that the places follow a path says more than likeness.
_LEAST_LIKENESS = 0.2
_NEAR_M = 0.012
_MOST_SCATTER_M = 0.003
_SCALE_M = 0.0015
# The start is known to this from the drop.
_START_SD_S = 0.03
# Errors of places this near in time are not independent: the cloth keeps its shape.
_BLOCK_S = 10.0
_FEWEST_PLACES = 12
# The share of the frames in which the edge must be recognised; at the end of the rates tried.
_LEAST_SHARE, _SHARE_AT_END = 0.3, 0.6
# What images this many seconds apart differ by more than images one second apart: noise and flicker
# cancel. Where the stage moves, it is 0.4 of the most or more (surrogate films); where it stands,
# 0.01 or less, with noise of 12 of 255 and 5 % flicker too.
_STILL_SHARE, _LAG, _THUMBNAIL_PX = 0.15, 4, 48
# An edge this near to the fitted path is on it.
_ON_PATH_M = 0.004
# A film's clock: corrected from here on if it is told that closely, noted, refused; and how far the
# stage may stand from the path at any time.
_CORRECTED_RATE, _NOTED_RATE, _REFUSED_RATE = 0.001, 0.005, 0.02
_CERTAIN = 3.0
_NOTED_OFFSET_M, _REFUSED_OFFSET_M = 0.004, 0.008
#: A shorter part of the drag does not tell a clock, and is not spoilt by a wrong one.
SHORTEST_DRAG_S = 15.0


@dataclass(frozen=True)
class TimeBase:
    """The clock of a video relative to the stage."""

    rate: float  # speed of the stage in the video's time, relative to the protocol's
    rate_sd: float  # standard deviation of `rate`
    # (n,): moments in the film's time from the start, and how far the stage stood ahead (along the
    # track) of where the fitted path has it
    time_s: np.ndarray
    offset_m: np.ndarray

    def worst_offset_m(self) -> float:
        """The largest median offset over 10 s (a cut in the video is a jump)."""
        return max(
            (abs(float(np.median(self.offset_m[block]))) for block in _full_blocks(self.time_s)),
            default=0.0,
        )


class StageFollower:
    """Finds the cloth's upper edge along the track, frame by frame."""

    def __init__(self, lens: Camera, schedule: Schedule):
        path = schedule.path
        height = path.lowered_height_m
        rows = np.arange(_ABOVE_M, -_BELOW_M, -_GRID_M)
        columns = np.arange(-_HALF_WIDTH_M, _HALF_WIDTH_M, _GRID_M)
        points = in_stage_plane(schedule.crop(0.0), columns[None, :], (height + rows)[:, None])
        self._path = path
        reach_m = self._reach_m(path.duration_s)
        self._x_m = np.arange(-reach_m, path.stroke_m + reach_m, _GRID_M)
        self._knots_m = np.arange(self._x_m[0], self._x_m[-1] + _KNOT_M, _KNOT_M)
        shifted = points.reshape(1, -1, 3) + self._knots_m[:, None, None] * [1.0, 0, 0]
        places = lens.project(shifted.reshape(-1, 3)).astype(np.float32)
        self._knots = places.reshape(len(self._knots_m), *points.shape[:2], 2)
        step_px = np.linalg.norm(np.diff(self._knots[len(self._knots) // 2], axis=1), axis=-1)
        # What is finer than the grid would alias.
        self._blur_px = 0.6 * float(np.median(step_px))
        #: Told by the same frames.
        self.edge = EdgeFinder(lens, schedule)
        self._rest: list[np.ndarray] = []
        self._seen: list[tuple[float, np.ndarray]] = []
        self._thumbnails: list[np.ndarray] = []

    def choose(self, time_s: np.ndarray, is_key: np.ndarray) -> list[int]:
        """Which of a film's frames to add, where all their times (n,) from the start are known.

        Few are to be decoded: a frame that can be decoded without those before it (`is_key`) is
        taken in place of the frame that is due, if it is near.
        """
        rest = np.flatnonzero(is_at_rest(time_s, self._path))
        chosen = list(map(int, rest[:_REST_FRAMES]))
        if not chosen:
            return []
        last_s, keys = float(time_s[rest[-1]]), np.flatnonzero(is_key)
        while (due := int(np.searchsorted(time_s, last_s + INTERVAL_S - 1e-3))) < len(time_s):
            key = np.searchsorted(time_s[keys], last_s + _EARLIEST * INTERVAL_S)
            if key < len(keys) and time_s[keys[key]] < last_s + _LATEST * INTERVAL_S:
                due = int(keys[key])
            last_s = float(time_s[due])
            if last_s > self._path.duration_s:
                break
            chosen.append(due)
        return chosen

    def add(self, time_s: float, image: np.ndarray) -> None:
        """Look for the edge in a frame (rows, columns, 3) uint8 at a time from the start."""
        self.edge.add(time_s, image)
        away_m = abs(self._x_m - self._commanded_m(time_s))
        near = np.flatnonzero(away_m <= self._reach_m(time_s))
        grey, maps = self._part(image, self._maps(self._x_m[near]))
        x, y = maps[..., 0], maps[..., 1]
        patches = np.stack(
            [cv2.remap(grey, x[k], y[k], cv2.INTER_LINEAR) for k in range(len(maps))]
        )
        if is_at_rest(time_s, self._path):
            self._rest.append(patches[np.argmin(abs(self._x_m[near]))])
            return
        likeness = np.full(len(self._x_m), np.nan, np.float32)
        likeness[near] = _correlation(patches, np.mean(self._rest, axis=0))
        self._seen.append((time_s, likeness))
        self._thumbnails.append(_thumbnail(image))

    def still_from_s(self, time_base: TimeBase | None) -> float | None:
        """When, in the film's time from the start, everything began to stand still; None if never.

        Not where the edge was seen on its path: something else that moves can hide its motion.
        """
        if len(self._thumbnails) < _FEWEST_PLACES + _LAG:
            return None
        time_s = np.array([one for one, _ in self._seen])[_LAG:]
        images = np.array(self._thumbnails)
        one, several = (
            np.mean((images[_LAG:] - images[_LAG - back : len(images) - back]) ** 2, axis=(1, 2))
            for back in (1, _LAG)
        )
        blocks = _full_blocks(time_s)
        moved = np.array([np.median((several - one)[block]) for block in blocks])
        seen = np.zeros(0)
        if time_base is not None:
            seen = time_base.time_s[np.abs(time_base.offset_m) < _ON_PATH_M]
        followed = np.array([np.isin(time_s[block], seen).mean() for block in blocks])
        slow = moved <= _STILL_SHARE * moved.max(initial=0.0)
        still = np.flatnonzero(slow & (followed < 0.5))
        return float(time_s[blocks[still[0]][0]]) if len(still) else None

    def _reach_m(self, time_s: float) -> float:
        return _REACH_M + _REACH_RATE * self._path.speed_m_s * time_s

    def _maps(self, x_m: np.ndarray) -> np.ndarray:
        """Image position of the tracked part with the stage at `x_m` (n,)."""
        position = (x_m - self._knots_m[0]) / _KNOT_M
        below = np.clip(position.astype(int), 0, len(self._knots) - 2)
        share = (position - below).astype(np.float32)[:, None, None, None]
        return (1 - share) * self._knots[below] + share * self._knots[below + 1]

    def _commanded_m(self, time_s: float | np.ndarray) -> np.ndarray:
        return self._path.position_m(time_s)[0]

    def _part(self, image: np.ndarray, maps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The part of a frame that the maps reach, grey and smooth, and the maps into it."""
        part, maps = cut_out(image, maps, int(3 * self._blur_px) + 2)
        part = cv2.cvtColor(part, cv2.COLOR_BGR2GRAY)
        if self._blur_px > 0.3:
            part = cv2.GaussianBlur(part, (0, 0), self._blur_px)
        return part.astype(np.float32), maps

    def time_base(self) -> TimeBase | None:
        """The clock that explains the places best; None if too few were recognised."""
        if len(self._seen) < _FEWEST_PLACES:
            return None
        time_s = np.array([one for one, _ in self._seen])
        likeness = np.array([one for _, one in self._seen])
        scores = [np.nanmean(self._at(likeness, rate * time_s)) for rate in _RATES]
        best = int(np.argmax(scores))
        # At an end there is no peak: likeness that changes with the place alone is best there, too.
        share = _SHARE_AT_END if best in (0, len(_RATES) - 1) else _LEAST_SHARE
        rate = float(_RATES[best])
        place_m, height = self._peaks(likeness, self._commanded_m(rate * time_s))
        good = height > _LEAST_LIKENESS
        if good.sum() < max(_FEWEST_PLACES, share * len(good)):
            return None
        found = _fit(time_s[good], place_m[good], rate, self._path)
        scatter_m = 1.4826 * float(np.median(np.abs(found.offset_m)))
        return found if scatter_m < _MOST_SCATTER_M else None

    def _at(self, likeness: np.ndarray, time_s: np.ndarray) -> np.ndarray:
        """The likeness (frames,) at the places where a clock has the stage."""
        position = (self._commanded_m(time_s) - self._x_m[0]) / _GRID_M
        below = np.clip(position.astype(int), 0, len(self._x_m) - 2)
        share = position - below
        row = np.arange(len(likeness))
        return (1 - share) * likeness[row, below] + share * likeness[row, below + 1]

    def _peaks(self, likeness: np.ndarray, expected_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Place (m) and height of the best likeness near the expected places."""
        far = abs(self._x_m[None, :] - expected_m[:, None]) > _NEAR_M
        near = np.where(far | np.isnan(likeness), -1.0, likeness)
        peak = np.clip(near.argmax(axis=1), 1, near.shape[1] - 2)
        row = np.arange(len(near))
        before, at, after = (near[row, peak + k] for k in (-1, 0, 1))
        shift = vertex_of_parabola(before, at, after)
        inner = (before > -1) & (after > -1)
        return self._x_m[peak] + np.clip(shift, -1, 1) * _GRID_M, np.where(inner, at, -1.0)


def _thumbnail(image: np.ndarray) -> np.ndarray:
    """A small grey picture of a frame (rows, columns, 3), relative to its mean brightness."""
    rows = round(_THUMBNAIL_PX * image.shape[0] / image.shape[1])
    size = (min(_THUMBNAIL_PX, image.shape[1]), max(min(rows, image.shape[0]), 1))
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.float32)
    small = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    return small / max(float(small.mean()), 1.0)


def _correlation(patches: np.ndarray, template: np.ndarray) -> np.ndarray:
    """Normalised cross-correlation of patches (n, rows, columns) with one of their size."""
    flat = patches.reshape(len(patches), -1)
    flat = flat - flat.mean(axis=1, keepdims=True)
    wanted = template.ravel() - template.mean()
    norm = np.linalg.norm(flat, axis=1) * np.linalg.norm(wanted)
    return flat @ wanted / np.maximum(norm, 1e-6)


def _blocks(time_s: np.ndarray) -> list[np.ndarray]:
    number = (time_s // _BLOCK_S).astype(int)
    return [np.flatnonzero(number == one) for one in np.unique(number)]


def _full_blocks(time_s: np.ndarray) -> list[np.ndarray]:
    """Those with half of their frames at least: a median of one or two says nothing of 10 s."""
    return [block for block in _blocks(time_s) if len(block) >= 0.5 * _BLOCK_S / INTERVAL_S]


def _fit(time_s: np.ndarray, place_m: np.ndarray, rate: float, path: StagePath) -> TimeBase:
    """Rate, delay and a lean of the cloth to either side, by robust least squares.

    The cloth leans back from the clamps, forward and back alike by an amount of its own, which
    shifts where its upper edge is recognised: a constant each way, fitted along.
    """
    stroke = ((rate * time_s - path.drop_duration_s) // path.stroke_duration_s).astype(int)
    back = stroke % 2 == 1
    everything = np.arange(len(time_s))

    def offsets_m(parameters: np.ndarray, kept: np.ndarray) -> np.ndarray:
        """Residuals of the places kept for rate, delay (s) and the leans ahead and back (m)."""
        speed, late_s, ahead_m, behind_m = parameters
        expected_m, _ = path.position_m(speed * (time_s[kept] - late_s))
        return place_m[kept] - expected_m - np.where(back[kept], behind_m, ahead_m)

    def fitted(kept: np.ndarray) -> np.ndarray:
        def left_over(parameters: np.ndarray) -> np.ndarray:
            return np.append(offsets_m(parameters, kept) / _SCALE_M, parameters[1] / _START_SD_S)

        scales = [1e-3, 0.01, 1e-3, 1e-3]
        return least_squares(left_over, [rate, 0, 0, 0], x_scale=scales, loss="soft_l1").x

    whole = fitted(everything)
    # Blocks of time are independent, the places within one are not: the jackknife over blocks.
    parts = [fitted(np.setdiff1d(everything, block))[0] for block in _blocks(time_s)]
    rate_sd = float(np.std(parts) * np.sqrt(len(parts) - 1))
    return TimeBase(float(whole[0]), rate_sd, time_s, offsets_m(whole, everything))


def checked_rate(path, time_base: TimeBase | None) -> float:
    """Return the stage's speed in the video's time, to select frames by; BadInput if wrong."""
    if time_base is None:
        return 1.0
    off = time_base.rate - 1
    if abs(off) > _REFUSED_RATE:
        raise BadInput(
            f"{path}: the stage moves {time_base.rate:.4f} ± {time_base.rate_sd:.4f} times as "
            f"fast as in the protocol; at most {100 * _REFUSED_RATE:g} % deviation is allowed; "
            f"if the frame rate is wrong, give the correct one ({GIVE_RATE})"
        )
    worst_m = time_base.worst_offset_m()
    if worst_m > _REFUSED_OFFSET_M:
        raise BadInput(
            f"{path}: for 10 s the stage is {1e3 * worst_m:.0f} mm from its path in the "
            f"protocol; at most {1e3 * _REFUSED_OFFSET_M:g} mm are allowed: was the video cut, "
            "or did the stage stop?"
        )
    certain = abs(off) > max(_CERTAIN * time_base.rate_sd, _CORRECTED_RATE)
    return time_base.rate if certain else 1.0


def is_followed(schedule: Schedule) -> bool:
    """Whether a schedule shows enough of the drag to tell a film's clock."""
    return bool(schedule.time_s[-1] >= schedule.path.drop_duration_s + SHORTEST_DRAG_S)


def clock_notes(time_base: TimeBase | None, schedule: Schedule, corrected: bool) -> list[str]:
    """What a person should know of a film's clock."""
    if time_base is None:
        if not is_followed(schedule):
            return []
        return [
            "the clock of the video could not be verified: the cloth's upper edge was detected "
            "in too few frames; a wrong frame rate makes the friction wrong"
        ]
    notes = []
    # As far off as it may well be.
    if abs(time_base.rate - 1) + time_base.rate_sd >= _NOTED_RATE:
        notes.append(
            f"the stage moves {time_base.rate:.4f} ± {time_base.rate_sd:.4f} times as fast as in "
            f"the protocol; the frame times were {'' if corrected else 'not '}corrected for it: "
            "check the frame rate"
        )
    worst_m = time_base.worst_offset_m()
    if worst_m > _NOTED_OFFSET_M:
        notes.append(f"for 10 s the stage is {1e3 * worst_m:.1f} mm from its path in the protocol")
    return notes
