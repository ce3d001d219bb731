"""What a camera sees of the track, and its pose in the training range of an instrument."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from slipstitch.base.page.figures import new_figure, styled
from slipstitch.base.page.palette import BLUE, INK, SOFT, VERMILION
from slipstitch.film.measure import SHIPPED
from slipstitch.film.measure.measuring_bench import MeasuringBench, opened_bench
from slipstitch.film.stage_video import problem_of_view, seen_shares
from slipstitch.images.calibrated_view import BenchCamera
from slipstitch.images.camera import AIM_M, POSE
from slipstitch.learning.instrument.measuring import CARD
from slipstitch.learning.instrument.poses import TITLES, TOLERANCE, in_words, just_beyond, outside


@dataclass(frozen=True)
class CameraCheck:
    """A camera against the poses of an instrument's training."""

    bench: MeasuringBench
    tested: dict[str, list[float]]  # least and largest of each number of the pose
    seen: float  # smallest share of a crop along the track that the camera sees
    # what lies outside the range or the image, in words; empty: the camera may be used
    outside: list[str]
    read: tuple[Path, ...]  # files that this was read from

    def lines(self) -> list[str]:
        """The result for a terminal."""
        lines = [in_words(name, self.bench.pose[name], self.tested[name]) for name in POSE]
        lines.append(f"sees {100 * self.seen:.0f} % of the crop, at the worst time of the protocol")
        return lines + self.verdict()

    def verdict(self) -> list[str]:
        """Whether the camera may be used."""
        if self.outside:
            return [f"OUTSIDE: {problem}" for problem in self.outside]
        return [just_beyond(self.bench.pose, self.tested) or "within the training range"]


def check_camera(
    camera: str | Path, model: str | Path | None = None, config: str | Path | None = None
) -> CameraCheck:
    """Compare a camera's place with the training poses, its view with the track; else BadInput."""
    bench = opened_bench(camera, model, config)
    model = Path(model or SHIPPED)
    tested = bench.pose_range or {name: [0.0, 0.0] for name in POSE}
    shares = seen_shares(bench.lens, bench.schedule)
    problems = [*outside(bench.pose, tested), problem_of_view(bench.lens, bench.schedule, shares)]
    return CameraCheck(
        bench,
        tested,
        float(shares.min()),
        list(filter(None, problems)),
        (Path(camera), bench.config_path, model if model.is_file() else model / CARD),
    )


@styled
def check_figure(check: CameraCheck) -> Figure:
    """The bench from above and from the side of the camera: range, tolerance, camera; its roll."""
    figure = new_figure(9.0, 5.2)
    axes = figure.subplot_mosaic([["above", "aside"], ["roll", "roll"]], height_ratios=[1, 0.13])
    aim = np.array(AIM_M)
    colour = VERMILION if check.outside else INK

    def eye(**pose) -> np.ndarray:
        rotation, translation_m = BenchCamera(**pose).pose(*check.bench.schedule.pose)
        return -rotation.T @ translation_m

    def limits(name: str, margin: float) -> tuple[float, float]:
        low, high = check.tested[name]
        return low - margin * TOLERANCE[name], high + margin * TOLERANCE[name]

    def outline(name: str, margin: float, drawn) -> np.ndarray:
        turns = np.linspace(*limits(name, margin), 40)
        near, far = np.exp(limits("log_distance", margin))
        edge = [drawn(eye(**{name: turn, "distance": near})) for turn in turns]
        edge += [drawn(eye(**{name: turn, "distance": far})) for turn in turns[::-1]]
        return np.transpose([*edge, edge[0]])

    def from_above(place: np.ndarray) -> tuple[float, float]:
        return float(place[0]), float(place[1])

    def from_aside(place: np.ndarray) -> tuple[float, float]:
        return float(np.hypot(*(place - aim)[:2])), float(place[2])

    here = eye(
        yaw_deg=check.bench.pose["yaw_deg"],
        pitch_deg=check.bench.pose["pitch_deg"],
        distance=float(np.exp(check.bench.pose["log_distance"])),
    )
    above, aside, roll = axes["above"], axes["aside"], axes["roll"]
    for view, drawn, name in ((above, from_above, "yaw_deg"), (aside, from_aside, "pitch_deg")):
        trained = outline(name, 0, drawn)
        view.fill(*trained, color=BLUE, alpha=0.2, lw=0)
        view.plot(*trained, color=BLUE, lw=1.2, label="training range")
        admitted = outline(name, 1, drawn)
        view.plot(*admitted, color=BLUE, lw=1, ls="--", label="tolerance: refused beyond")
        middle, place = drawn(aim), drawn(here)
        view.plot(*np.transpose([middle, place]), color=colour, lw=0.8, ls=":")
        view.plot(*place, "o", color=colour, ms=7)
        view.annotate("this camera", place, (6, 6), textcoords="offset points", color=colour)
        view.plot(*middle, "+", color=SOFT, ms=9)
        view.set_aspect("equal", adjustable="datalim")
    above.annotate("", (0.3, 0), (0, 0), arrowprops={"arrowstyle": "->", "color": SOFT})
    above.annotate("drag", (0.3, 0.0), (4, 4), textcoords="offset points", color=SOFT)
    above.plot(-0.1, 0.1, alpha=0)  # room for the arrow
    above.set(xlabel="along the track, m", ylabel="across, m", title="from above")
    aside.set(xlabel="horizontal distance, m", ylabel="height, m", title="from the side")
    aside.legend(frameon=False, loc="best")
    roll.axvspan(*limits("roll_deg", 0), color=BLUE, alpha=0.2, lw=0)
    for limit in limits("roll_deg", 1):
        roll.axvline(limit, color=BLUE, lw=1, ls="--")
    roll.plot(check.bench.pose["roll_deg"], 0, "o", color=colour, ms=7)
    roll.set(yticks=[], ylim=(-1, 1), xlabel=", ".join(TITLES["roll_deg"]))
    roll.spines["left"].set_visible(False)
    figure.suptitle("\n".join(check.verdict()), color=colour, fontsize=9)
    return figure
