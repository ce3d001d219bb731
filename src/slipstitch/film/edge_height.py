"""Height of the lowered clamps above the floor, seen in the film: where the cloth's edge ends.

Between drop and drag the cloth rests at the track's beginning; later, with the stage far ahead, the
camera sees what lies behind its upper edge. The difference of the two is nothing above the edge and
something below, whatever cloth and floor look like. The edge hangs through between the clamps,
which may hide their corners: its curve is fitted between them and continued to them.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.optimize import minimize
from scipy.special import ndtr

from slipstitch.design.stage_path import SIDE_M, TAB_M, StagePath
from slipstitch.film.frame_schedule import Schedule
from slipstitch.images.camera import Camera
from slipstitch.images.encoding import LINEAR
from slipstitch.images.rectification import across_the_track, bounds, in_stage_plane

# The stage rests between drop and drag, give or take this.
_REST_S = 0.35
# So far along the track, the cloth no longer covers what is behind its upper edge at rest.
_CLEAR_M = 0.1
_MOST_BEHIND = 12  # frames: more would take longer and tell no more
# Where the edge is looked for: between the clamps, and above and below the height that it should
# have, on a grid this fine across and upwards.
_SPAN_M, _ABOVE_M, _BELOW_M = SIDE_M / 2 - TAB_M - 0.004, 0.009, 0.020
_ACROSS_M, _UP_M = 0.002, 0.0005
# Of 27 simulations of the ten fabrics: the sag falls off from the middle with this power of the
# distance, and the edge bulges ahead by so many times its sag. What is left of the height is an
# error of this standard deviation.
_POWER, _BULGE = 1.3, 3.0
_SHAPE_SD_M = 0.0002
_BLOCKS = 8
# An edge explains so much of the light in at least so many of the columns, or is none.
_EXPLAINED, _SHARE = 0.5, 0.4
# Nor is an edge that rises by more from the middle to a clamp: they are level within half of it.
_RISE_MM = 1.0


def is_at_rest(time_s: float | np.ndarray, path: StagePath) -> bool | np.ndarray:
    """Whether the stage rests between drop and drag, at times from its start."""
    return np.abs(time_s - path.drop_duration_s) <= _REST_S


def cut_out(image: np.ndarray, place: np.ndarray, margin: int) -> tuple[np.ndarray, np.ndarray]:
    """The part of an image that holds places (..., 2) in it, and the places in the part."""
    last = np.array(image.shape[1::-1]) - 1
    low, high = bounds(place)
    low = np.clip(np.floor(low).astype(int) - margin, 0, last)
    high = np.clip(np.ceil(high).astype(int) + margin, low + 1, last + 1)
    return image[low[1] : high[1], low[0] : high[0]], place - low.astype(np.float32)


@dataclass(frozen=True)
class EdgeHeight:
    """Height of the clamps above the floor, as far as the image tells it."""

    height_m: float
    error_m: float  # standard deviation, behind a camera that is known exactly


class EdgeFinder:
    """Finds the upper edge at rest, from the frames of a film."""

    def __init__(self, lens: Camera, schedule: Schedule):
        self._path, crop = schedule.path, schedule.crop(0.0)
        self._is_seen = across_the_track(crop)
        self._eye = -lens.rotation.T @ lens.translation_m
        self._y_m = np.arange(-_SPAN_M, _SPAN_M + 1e-9, _ACROSS_M)
        self._up_m = np.arange(_ABOVE_M, -_BELOW_M, -_UP_M)
        height_m = self._path.lowered_height_m + self._up_m[:, None]
        points = in_stage_plane(crop, self._y_m[None, :], height_m)
        place = lens.project(points.reshape(-1, 3)).reshape(*points.shape[:2], 2)
        self._place = place.astype(np.float32)
        rows_px = np.linalg.norm(np.diff(self._place, axis=0), axis=-1)
        self._pixel_m = _UP_M / float(rows_px.mean())
        self._rest: list[np.ndarray] = []
        self._behind: list[np.ndarray] = []

    def add(self, time_s: float, image: np.ndarray) -> None:
        """Take a frame (rows, columns, 3) uint8 at a time from the start, where it is of use."""
        if not self._is_seen:
            return
        if is_at_rest(time_s, self._path):
            self._rest.append(self._light(image))
        elif len(self._behind) < _MOST_BEHIND and self._path.position_m(time_s)[0] >= _CLEAR_M:
            self._behind.append(self._light(image))

    def _light(self, image: np.ndarray) -> np.ndarray:
        """Linear light on the grid, rows downwards."""
        part, place = cut_out(image, self._place, 2)
        grey = LINEAR[part].mean(axis=-1, dtype=np.float32)
        return cv2.remap(grey, place[..., 0], place[..., 1], cv2.INTER_LINEAR)

    def found(self) -> EdgeHeight | None:
        """The height that explains the light best; None if no edge can be told."""
        if not self._rest or not self._behind:
            return None
        rest, behind = np.mean(self._rest, axis=0), np.median(self._behind, axis=0)
        above = self._up_m > _ABOVE_M / 2
        gain = float((rest * behind)[above].sum() / max((behind[above] ** 2).sum(), 1e-12))
        light = rest - gain * behind
        columns = np.arange(light.shape[1])
        starts = [(up, sag, 0.0) for up in np.arange(-4, 4.1, 1) for sag in (0.5, 2, 4, 6)]
        start = min(starts, key=lambda one: self._cost(np.array(one), light, columns))
        whole = self._fit(start, light, columns)
        explained = 1 - self._left_over(whole, light, columns) / ((light**2).sum(axis=0) + 1e-9)
        if np.mean(explained > _EXPLAINED) < _SHARE or abs(whole[2]) > _RISE_MM:
            return None
        blocks = np.array_split(columns, _BLOCKS)
        parts = [self._fit(whole, light, np.setdiff1d(columns, block))[0] for block in blocks]
        scatter_m = 1e-3 * float(np.std(parts)) * np.sqrt(_BLOCKS - 1)
        height_m = self._path.lowered_height_m + 1e-3 * float(whole[0])
        return EdgeHeight(height_m, float(np.hypot(scatter_m, _SHAPE_SD_M)))

    def _fit(self, start, light: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Height above the protocol's, sag, and rise over half the width, in mm."""
        start = np.asarray(start)
        first = start + np.vstack([np.zeros(3), np.diag([0.7, 0.7, 0.4])])
        options = {"initial_simplex": first, "xatol": 1e-3, "fatol": 1e-3}
        return minimize(
            self._cost, start, (light, columns), method="Nelder-Mead", options=options
        ).x

    def _cost(self, mm: np.ndarray, light: np.ndarray, columns: np.ndarray) -> float:
        """Sum of the logarithms: the noise and the contrast of each column are its own."""
        return float(np.log(self._left_over(mm, light, columns)).sum())

    def _left_over(self, mm: np.ndarray, light: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Squares of what a step at the edge, with any slope below it, leaves of each column."""
        below_m = self._curve_m(*(1e-3 * mm))[None, columns] - self._up_m[:, None]
        step = ndtr(below_m / (0.5 * self._pixel_m))
        slope, seen = step * below_m / _BELOW_M, light[:, columns]
        of = np.stack([step, slope])
        inner = np.einsum("ijk,ljk->kil", of, of) + 1e-9 * np.eye(2)
        wanted = np.einsum("ijk,jk->ki", of, seen)
        found = np.linalg.solve(inner, wanted[..., None])[..., 0]
        left_over: np.ndarray = (seen**2).sum(axis=0) - (found * wanted).sum(axis=1)
        return np.maximum(left_over, 0.0) + 1e-9

    def _curve_m(self, above_m: float, sag_m: float, rise_m: float) -> np.ndarray:
        """Where the edge is seen in the plane of the clamps, above the protocol's height."""
        y_m = np.linspace(-SIDE_M / 2, SIDE_M / 2, 81)
        hung_m = sag_m * np.clip(1 - np.abs(y_m / (SIDE_M / 2 - TAB_M)) ** _POWER, 0, None)
        z_m = self._path.lowered_height_m + above_m - hung_m + rise_m * y_m / (SIDE_M / 2)
        edge = np.column_stack([_BULGE * hung_m, y_m, z_m])
        share = edge[:, :1] / (self._eye[0] - edge[:, :1])
        seen = edge + share * (edge - self._eye)
        return np.interp(self._y_m, seen[:, 1], seen[:, 2]) - self._path.lowered_height_m
