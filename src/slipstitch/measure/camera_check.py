"""Pose of a camera, and the training range of an instrument."""

import os
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from slipstitch.instrument import load_instrument
from slipstitch.instrument.poses import in_words, just_beyond, outside
from slipstitch.measure import SHIPPED
from slipstitch.measure.measuring import schedule_of
from slipstitch.page.figures import new_figure, styled
from slipstitch.page.palette import BLUE, INK, SOFT, VERMILION
from slipstitch.render.bench_camera import BenchCamera, relative_pose
from slipstitch.render.camera import AIM_M
from slipstitch.render.camera_file import read_camera_file
from slipstitch.render.pose import POSE


@dataclass(frozen=True)
class CameraCheck:
    """A camera against the poses of an instrument's training.

    Attributes
    ----------
    pose : dict
        Pose of the camera relative to the calibrated viewpoint (`slipstitch.render.bench_camera`).
    tested : dict
        Least and largest of each number.
    viewpoint : tuple of ndarray
        Rotation and translation of the calibrated viewpoint.
    outside : list of str
        What lies outside, in words; empty: the camera may be used.
    """

    pose: dict[str, float]
    tested: dict[str, list[float]]
    viewpoint: tuple[np.ndarray, np.ndarray]
    outside: list[str]

    def lines(self) -> list[str]:
        """The result for a terminal."""
        lines = [in_words(name, self.pose[name], self.tested[name]) for name in POSE]
        if self.outside:
            return lines + [f"OUTSIDE: {problem}" for problem in self.outside]
        return [*lines, just_beyond(self.pose, self.tested) or "within the training range"]


def check_camera(
    camera: str | os.PathLike,
    model: str | os.PathLike | None = None,
    config: str | os.PathLike | None = None,
) -> CameraCheck:
    """Compare a camera's place with the poses of an instrument's training.

    Parameters
    ----------
    camera : path
        The camera file.
    model : path, optional
        The instrument's folder; by default the instrument that comes with Slipstitch.
    config : path, optional
        What the instrument was trained with; by default the nearest ``config.json`` above it.

    Raises
    ------
    BadInput
        If a file cannot be used.
    """
    lens = read_camera_file(camera)
    model = model or SHIPPED
    instrument = load_instrument(model)
    _, schedule = schedule_of(instrument, model, config)
    pose = relative_pose(*lens.pose, schedule.pose)
    tested = instrument.card.get("pose_range") or {name: [0.0, 0.0] for name in POSE}
    return CameraCheck(pose, tested, schedule.pose, outside(pose, tested))


@styled
def check_figure(check: CameraCheck) -> Figure:
    """The bench from above and from the side of the camera: the range, and the camera."""
    figure = new_figure(9.0, 4.2)
    above, aside = figure.subplots(1, 2)
    aim = np.array(AIM_M)
    yaw, pitch = (
        np.linspace(check.tested[name][0], check.tested[name][1], 40)
        for name in ("yaw_deg", "pitch_deg")
    )
    near, far = (float(np.exp(end)) for end in check.tested["log_distance"])

    def eye(**pose) -> np.ndarray:
        rotation, translation_m = BenchCamera(**pose).pose(*check.viewpoint)
        return -rotation.T @ translation_m

    def outline(axes, name: str, turns: np.ndarray, drawn) -> None:
        edge = [drawn(eye(**{name: turn, "distance": near})) for turn in turns]
        edge += [drawn(eye(**{name: turn, "distance": far})) for turn in turns[::-1]]
        axes.fill(*np.transpose(edge), color=BLUE, alpha=0.2, lw=0)
        axes.plot(*np.transpose([*edge, edge[0]]), color=BLUE, lw=1.2)

    def from_above(place: np.ndarray) -> tuple[float, float]:
        return float(place[0]), float(place[1])

    def from_aside(place: np.ndarray) -> tuple[float, float]:
        return float(np.hypot(*(place - aim)[:2])), float(place[2])

    here = eye(
        yaw_deg=check.pose["yaw_deg"],
        pitch_deg=check.pose["pitch_deg"],
        distance=float(np.exp(check.pose["log_distance"])),
    )
    colour = VERMILION if check.outside else INK
    for axes, drawn, name, turns in (
        (above, from_above, "yaw_deg", yaw),
        (aside, from_aside, "pitch_deg", pitch),
    ):
        outline(axes, name, turns, drawn)
        middle, place = drawn(aim), drawn(here)
        axes.plot(*np.transpose([middle, place]), color=colour, lw=0.8, ls=":")
        axes.plot(*place, "o", color=colour, ms=7)
        axes.annotate("this camera", place, (6, 6), textcoords="offset points", color=colour)
        axes.plot(*middle, "+", color=SOFT, ms=9)
        axes.set_aspect("equal", adjustable="datalim")
    above.annotate("", (0.3, 0), (0, 0), arrowprops={"arrowstyle": "->", "color": SOFT})
    above.annotate("drag", (0.3, 0.0), (4, 4), textcoords="offset points", color=SOFT)
    above.plot(-0.1, 0.1, alpha=0)  # room for the arrow
    above.set(xlabel="along the track, m", ylabel="across, m", title="from above")
    aside.set(xlabel="horizontal distance, m", ylabel="height, m", title="from the side")
    return figure
