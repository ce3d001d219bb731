"""Measurement of videos: results of the instrument and its input frames."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from slipstitch.base.errors import BadInput, Damaged
from slipstitch.base.provenance import file_digest
from slipstitch.config import Config, load_config
from slipstitch.config.train import REFLECTIVE
from slipstitch.design.grid import sampled_frames
from slipstitch.film.frame_schedule import Schedule
from slipstitch.film.measure import SHIPPED
from slipstitch.film.measure.clamp_height import (
    ASSUMED_M,
    READING_PER_M,
    ClampHeight,
    SeenClamps,
    told_height,
)
from slipstitch.film.measure.told_fabric import QUANTITIES, ToldFabric
from slipstitch.film.stage_video import StageVideo, problem_of_view, read_stage_video, seen_shares
from slipstitch.images.calibrated_view import POSITION_SD_M, ROTATION_SD_DEG
from slipstitch.images.camera import AIM_M, POSE, Camera, relative_pose
from slipstitch.images.camera_file import read_camera_file, stated_height_error_m
from slipstitch.learning.instrument.distribution import quantiles
from slipstitch.learning.instrument.measuring import Instrument, load_instrument
from slipstitch.learning.instrument.poses import just_beyond, outside
from slipstitch.learning.prediction import Prediction

# Within one standard deviation, were the distribution normal.
_STANDARD_SHARE = 0.6827
_OUTSIDE = "the pose of the camera is outside the training range of the instrument"


@dataclass(frozen=True)
class MeasuredVideo:
    """A measurement with the frames that it rests on."""

    name: str  # of the video file
    video: StageVideo
    measurement: Prediction
    # half the width of the middle 68 % of the distribution, stretched as its interval is
    uncertainty: float
    bench: "MeasuringBench"
    clamps: ClampHeight | None = None  # by which the reading was corrected
    seen_clamps: SeenClamps | None = None
    # (frames, points, 2): where the instrument sees the cloth's keypoints in the frames, if it
    # learnt to
    keypoints_px: np.ndarray | None = None
    path: Path = Path()

    @property
    def instrument(self) -> str:
        """What identifies the instrument: the digest of its weights, if its card has one."""
        return str(self.bench.instrument.card.get("weights_sha256") or "unknown")

    @property
    def without_error_bar(self) -> str:
        """Why the interval is the whole grid; empty where it is not."""
        return self.bench.instrument.without_error_bar

    @property
    def notes(self) -> list[str]:
        """What is to be known of the video and of the instrument."""
        notes = [*self.video.notes, *self.bench.caveats]
        if clamps := self.clamps:
            notes.append(clamps.note(self.measurement.friction_coefficient))
        if (seen := self.seen_clamps) and not (clamps and clamps is not self.bench.clamps):
            notes += filter(None, [seen.contradiction(clamps)])
        return notes

    @property
    def alarm_reason(self) -> str:
        """Why the numbers are not reliable, and what lies outside the training; empty if nothing.

        The images, the camera's pose, the fabric and the clamps; the images do not say which way.
        """
        images, outside, seen = self.measurement.alarm_reason, self.bench.outside, self.seen_clamps
        fabric = self.bench.fabric
        pose = f"{_OUTSIDE}: {'; '.join(outside)}" if outside else ""
        reasons = [images, pose, fabric.outside]
        known = self.clamps or (seen if seen and seen.is_exact else None)
        is_too_far = not self.clamps and bool(seen and seen.is_too_far)
        is_trained = not known or abs(known.height_m - known.protocol_m) <= ASSUMED_M
        if not is_trained and (images or is_too_far):
            reasons.append(f"the clamps hang at {known} (trained on {self.bench.trained_heights})")
        elif images and self.bench.pose_range and not outside and not fabric.outside:
            what = "camera and clamps are" if known else "the camera is"
            left = "light, sharpness, scene" + ("" if fabric.told else ", fabric")
            reasons.append(f"{what} as in the training: look at {left}")
        return "; ".join(filter(None, reasons))

    @property
    def height_of_clamps(self) -> str:
        """The height, how it is known, and what it is worth where it is not."""
        seen = self.seen_clamps
        if self.clamps:
            return str(self.clamps)
        height_mm = 1e3 * self.bench.schedule.path.lowered_height_m
        of_height = abs(READING_PER_M) * ASSUMED_M * self.measurement.friction_coefficient
        return (
            f"assumed {height_mm:g} ± {1e3 * ASSUMED_M:g} mm, ± {of_height:.3f} of friction within "
            f"its interval{f'; the film shows {seen}' if seen else ''}"
        )

    @property
    def fabric(self) -> tuple[str, float]:
        """The likeliest fabric and its probability."""
        return max(self.measurement.material_probabilities.items(), key=lambda item: item[1])

    def lines(self) -> list[str]:
        """The result for a terminal."""
        measured = self.measurement
        low, high = measured.interval_90
        fabric, share = self.fabric
        error_bar = f" ± {self.uncertainty:.3f}, 90 % interval {low:.3f} ... {high:.3f}"
        lines = [
            f"friction {measured.friction_coefficient:.3f}"
            + (f", {self.without_error_bar}" if self.without_error_bar else error_bar),
            f"most similar fabric {fabric} ({100 * share:.0f} %)",
        ]
        lines += [f"note: {note}" for note in self.notes]
        if self.alarm_reason:
            lines.append(f"ALARM: {self.alarm_reason}: these numbers are not reliable")
        else:
            lines.append("no alarm")
        return lines

    def numbers(self) -> dict[str, Any]:
        """The result for a program."""
        measured, video, clamps = self.measurement, self.video, self.clamps
        seen = self.seen_clamps
        return {
            "video": self.name,
            "friction_coefficient": measured.friction_coefficient,
            "clamp_height_mm": clamps and 1e3 * clamps.height_m,
            "clamp_height_error_mm": clamps and 1e3 * clamps.error_m,
            "clamp_height_source": clamps and clamps.source,
            "clamp_height_factor": clamps and clamps.factor,
            "clamp_height_seen_mm": seen and 1e3 * seen.height_m,
            "clamp_height_seen_error_mm": seen and 1e3 * seen.error_m,
            **{name: self.bench.fabric.told.get(name) for name in QUANTITIES},
            "uncertainty": None if self.without_error_bar else self.uncertainty,
            "interval_90": list(map(float, measured.interval_90)),
            "distribution": [np.asarray(part).tolist() for part in measured.distribution],
            "material_probabilities": measured.material_probabilities,
            "alarm": bool(self.alarm_reason),
            "alarm_reason": self.alarm_reason,
            "alarm_of_images": bool(measured.alarm),
            "frame_time_s": video.time_s.tolist(),
            "moments": np.asarray(measured.attention_weights).tolist(),
            "stage_start_s": video.start.time_s,
            "stage_start_found": video.start.found,
            "stage_speed": video.time_base and video.time_base.rate,
            "stage_speed_sd": video.time_base and video.time_base.rate_sd,
            "without_error_bar": self.without_error_bar,
            "notes": self.notes,
            "instrument": self.instrument,
        }


@dataclass(frozen=True)
class MeasuringBench:
    """An instrument behind a camera: what all videos of one place share."""

    lens: Camera
    instrument: Instrument
    config_path: Path  # the configuration that told which frames to take
    schedule: Schedule
    floors: tuple[str, ...]  # floors of the training
    is_shipped: bool  # whether its response to the clamps' height is known
    height_error_m: float  # standard deviation of heights that the camera tells
    fabric: ToldFabric
    clamps: ClampHeight | None = None  # as told; None: as high as the protocol says

    @property
    def pose_range(self) -> dict[str, list[float]] | None:
        """Least and largest of each number of the training poses, if the instrument knows them."""
        return self.instrument.card.get("pose_range")

    @property
    def pose(self) -> dict[str, float]:
        """Pose of the camera relative to the calibrated viewpoint."""
        return relative_pose(self.lens.pose, self.schedule.pose)

    @property
    def outside(self) -> tuple[str, ...]:
        """Where the camera's pose is outside the training range, in words."""
        return tuple(outside(self.pose, self.pose_range)) if self.pose_range else ()

    @property
    def trained_heights(self) -> str:
        """Between which the lowered clamps hung in the training, nearly always."""
        height_mm = 1e3 * self.schedule.path.lowered_height_m
        return " ... ".join(f"{height_mm + sign * 1e3 * ASSUMED_M:g}" for sign in (-1, 1)) + " mm"

    @property
    def caveats(self) -> tuple[str, ...]:
        """What an error bar does not cover here."""
        beyond = just_beyond(self.pose, self.pose_range) if self.pose_range else ""
        return (*self.instrument.caveats, *filter(None, [beyond]))

    def told(
        self,
        clamp_height_mm: float | None,
        clamp_height_error_mm: float | None,
        **fabric: float | None,
    ) -> "MeasuringBench":
        """Return the bench with what was told of it; None: not told. BadInput if of no bench.

        Parameters
        ----------
        clamp_height_mm, clamp_height_error_mm : float, optional
            Of the lowered clamps; see `slipstitch.film.measure.clamp_height.told_height`.
        **fabric : float, optional
            By the names of `slipstitch.film.measure.told_fabric.QUANTITIES`.
        """
        known = {name: value for name, value in fabric.items() if value is not None}
        protocol_m = self.schedule.path.lowered_height_m
        clamps = told_height(clamp_height_mm, clamp_height_error_mm, protocol_m, self.is_shipped)
        return replace(self, clamps=clamps, fabric=replace(self.fabric, told=known))

    def measure(
        self, path: str | Path, *, start_s: float | None = None, frame_rate_hz: float | None = None
    ) -> MeasuredVideo:
        """Measure one video as `read_stage_video` reads it; BadInput if it cannot be used."""
        video = read_stage_video(
            path,
            self.lens,
            self.schedule,
            start_s=start_s,
            frame_rate_hz=frame_rate_hz,
            note_far_view=self.pose_range is None,
        )
        pose = np.array([video.pose[name] for name in POSE])
        measured = self.instrument.measure(video.frames, pose)
        grid, probability = map(np.asarray, measured.distribution)
        factor = self.instrument.conformal_scale
        uncertainty = _half_width(grid, probability) * (factor if math.isfinite(factor) else 1.0)
        edge = video.edge and video.edge.found()
        seen = edge and SeenClamps(
            edge.height_m, edge.error_m, self.height_error_m, self.schedule.path.lowered_height_m
        )
        clamps = self.clamps or (seen.measured() if seen and self.is_shipped else None)
        if clamps:
            measured = clamps.corrected(measured)
            of_height = clamps.relative_error * measured.friction_coefficient
            uncertainty = math.hypot(clamps.factor * uncertainty, of_height)
        return MeasuredVideo(
            Path(path).name,
            video,
            measured,
            uncertainty,
            self,
            clamps,
            seen,
            self._keypoints_px(video, measured),
            Path(path),
        )

    def _keypoints_px(self, video: StageVideo, measured: Prediction) -> np.ndarray | None:
        """The cloth's keypoints as the instrument sees them, in the frames."""
        if measured.points_m is None:
            return None
        places_m = measured.points_m.copy()
        places_m[..., 0] += video.stage_x_m[:, None]
        return np.stack(
            [
                self.schedule.crop(float(time_s)).project(places)
                for time_s, places in zip(video.time_s, places_m, strict=True)
            ]
        )


def measuring_bench(
    camera: str | Path,
    model: str | Path | None = None,
    config: str | Path | None = None,
    threads: int = 2,
    force: bool = False,
) -> MeasuringBench:
    """Read the camera, the instrument and what it was trained with; refuse what cannot be used.

    Parameters
    ----------
    model : path, optional
        The instrument's folder; by default the instrument that comes with Slipstitch.
    config : path, optional
        What the instrument was trained with; by default the nearest ``config.json`` above it.
    force : bool
        Measure although the camera stands where the instrument was never tried; with an alarm.

    BadInput if a file cannot be used, or the camera stands outside the poses of the training,
    or does not see the track, or too coarsely.
    """
    bench = opened_bench(camera, model, config)
    if bench.outside and not force:
        raise BadInput(
            f"{camera}: {_OUTSIDE}: {'; '.join(bench.outside)}; see `slipstitch capture check`; "
            "--force measures anyway, with an alarm"
        )
    # Before any film is read: in one, such a camera would find no start of the stage's motion.
    if problem := problem_of_view(
        bench.lens, bench.schedule, seen_shares(bench.lens, bench.schedule)
    ):
        raise BadInput(f"{camera}: {problem}; see `slipstitch capture check`")
    # Deterministic algorithms matter to training only; asking for them would load torch's compiler,
    # which takes longer than the measurement.
    torch.set_num_threads(threads)
    return bench


def opened_bench(
    camera: str | Path, model: str | Path | None, config: str | Path | None
) -> MeasuringBench:
    """Read what `measuring_bench` reads, wherever the camera stands."""
    lens, model = read_camera_file(camera), model or SHIPPED
    instrument = load_instrument(model)
    config_path = _config_of(model, config)
    settings = load_config(config_path)
    frames, sampled = int(instrument.card["frames"]), settings.sample.frames
    if frames > sampled:
        raise BadInput(
            f"{config_path}: sample.frames is {sampled}, the instrument in {model} was trained "
            f"with {frames}; give its configuration with --config"
        )
    schedule = Schedule.of(settings)
    # Of a dataset with more frames than it sees, an instrument takes some at regular intervals.
    schedule = replace(schedule, frame=schedule.frame[sampled_frames(sampled, frames)])
    floors = list(settings.render.floors)
    if instrument.card.get("split") == REFLECTIVE:
        floors += settings.render.reflective_floors
    return MeasuringBench(
        lens,
        instrument,
        config_path,
        schedule,
        tuple(dict.fromkeys(floors)),
        is_shipped=Path(model) == SHIPPED,
        height_error_m=stated_height_error_m(camera) or _trained_height_error_m(lens),
        fabric=ToldFabric(instrument.card["materials"]),
    )


def _trained_height_error_m(lens: Camera) -> float:
    """Standard deviation of heights that a camera tells whose calibration errs as in training."""
    away_m = -lens.rotation.T @ lens.translation_m - AIM_M
    distance_m = float(np.linalg.norm(away_m))
    across_m = math.hypot(math.radians(ROTATION_SD_DEG) * distance_m, POSITION_SD_M)
    return across_m * distance_m / math.hypot(*away_m[:2])


def shipped_for(config: Config) -> Path | None:
    """Return the shipped instrument's folder, if a dataset has its path, times and viewpoint."""
    trained, videos = map(Schedule.of, (load_config(SHIPPED / "config.json"), config))
    alike = (
        "calibrated" in config.render.viewpoints
        and videos.path == trained.path
        and np.array_equal(videos.time_s, trained.time_s)
        and all(map(np.array_equal, videos.pose, trained.pose))
    )
    return SHIPPED if alike else None


def _config_of(model: str | Path, given: str | Path | None) -> Path:
    if given is not None:
        return Path(given)
    folder = Path(model).resolve()
    for above in (folder, *folder.parents):
        found = above / "config.json"
        if found.is_file():
            _check_listed(found)
            return found
    raise BadInput(
        f"{model}: no config.json in a folder above it; give the configuration with --config"
    )


def _check_listed(config_path: Path) -> None:
    """Damaged if the ``SHA256SUMS`` beside a configuration, where there is one, has another."""
    sums = config_path.with_name("SHA256SUMS")
    text = sums.read_text(encoding="utf-8", errors="replace") if sums.is_file() else ""
    named = ([config_path.name], [f"*{config_path.name}"])  # sha256sum, sha256sum -b
    digests = [line.split()[0] for line in text.splitlines() if line.split()[1:] in named]
    if digests and file_digest(config_path) not in digests:
        raise Damaged(config_path, f"altered or damaged: not the file listed in {sums.name}")


def _half_width(grid: np.ndarray, probability: np.ndarray) -> float:
    """Half the width of the middle 68 % of a distribution."""
    tails = (1 - _STANDARD_SHARE) / 2
    low, high = quantiles(probability[None], grid, np.array([tails, 1 - tails]))[0]
    return float(high - low) / 2
