"""Surrogate captures: a bench's camera, inclined plane and table, and its simulated videos.

Nothing of the bench is known to the networks, and only what a real bench would write down is handed
on: a calibrated camera with its errors, slip angles, a table of videos. A video is simulated,
rendered, distorted by a lens, exposed and compressed.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pandas

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import (
    atomic_path,
    provenance_record,
    start_clock,
    write_sidecar,
    write_text,
)
from slipstitch.config import Config
from slipstitch.config.catalogue import FLOORS
from slipstitch.config.dataset import CaptureSettings, PairSettings
from slipstitch.config.simulation import SimulationSettings
from slipstitch.design.grid import simulation_seed
from slipstitch.design.stage_path import StagePath
from slipstitch.film.edge_height import is_at_rest
from slipstitch.images.calibrated_view import viewpoint_pose
from slipstitch.images.camera import Camera, turned
from slipstitch.images.camera_file import camera_record, write_camera_file
from slipstitch.images.composition import compose_light, join
from slipstitch.images.encoding import CameraEffects
from slipstitch.images.packing import render_shadings
from slipstitch.images.surroundings import LAMP_POSITION_M, Surroundings, draw_look, generator
from slipstitch.images.view import Shot
from slipstitch.physics.simulation.drop_and_drag import DropAndDrag, simulate_drop_and_drag
from slipstitch.physics.simulation.trajectory import Trajectory

# A bench is less exact than training's: what it varies by between videos, and is wrong by.
BENCH_VARIATION = 1.5  # of clamps and fabric, times the defaults of the section simulation
FRICTION_SD_REL = 0.03  # between positions on a substrate
INCLINE_ERROR_DEG = 0.3  # largest, of the inclined plane's angle
CAMERA_TURN_DEG = 2.0  # from the viewpoint
CAMERA_ERROR_M = 0.001  # of the position in the camera file, along each axis
LENS_K1 = -0.12  # barrel distortion of a cheap lens
FRAME_RATE_HZ = 12.0  # while the stage starts
# What a consumer camera does to a video.
EXPOSURE_DRIFT_STOPS = 0.25
COLOUR_CAST = 0.06  # scaling of red and blue
NOISE = 0.02  # as render.augmentation.noise
QUALITY_CRF = "26"  # constant rate factor of H.264

_FOCAL_WIDTHS = 1.72  # so that the whole travel is in the image
_REST_S = 3.4  # the cloth hangs still
_START_S = 3.0  # the stage's start is filmed at the full rate for that long
_MARGIN = 1.12  # what the lens pulls in from beyond the pinhole's image
_CLOCK = Fraction(1, 90000)
_PLACES, _REPEATS = 4, 2
_ORIENTATIONS = {"warp": 0.01, "weft": -0.01}
_ANGLE_SCATTER = 0.02


@dataclass(frozen=True)
class Film:
    """One surrogate capture."""

    id: str
    pair: PairSettings
    repeat: int
    friction: float  # where the fabric lay this time
    seed: int  # of the clamps and the fabric


def films(config: Config) -> list[Film]:
    """All videos of the configuration, in the order of their ids."""
    settings = config.captures
    made = []
    for name in settings.surrogate_ids():
        pair = settings.pairs[int(name[1:3])]
        repeat = int(name[-2:])
        rng = generator(config.seed, "surrogate", pair.material, pair.substrate, str(repeat))
        friction = pair.friction * float(np.exp(FRICTION_SD_REL * rng.standard_normal()))
        seed = simulation_seed(config.seed + 1, f"surrogate {name}", repeat)
        made.append(Film(name, pair, repeat, friction, seed))
    return made


def find_film(config: Config, name: str) -> Film:
    """The video with id `name`; BadInput if there is none."""
    known = {film.id: film for film in films(config)}
    if name not in known:
        raise BadInput(f"unknown surrogate capture {name!r}; known: {', '.join(known)}")
    return known[name]


def surrogate_simulation(config: Config) -> SimulationSettings:
    """Settings of the simulations: as for the training data, except for the distribution shift."""
    settings, training = config.captures, config.simulation
    # Not in units of the training's own variation: that of the paper's experiment is none.
    factor, usual = BENCH_VARIATION, SimulationSettings()
    return training.model_copy(
        update={
            "vertices_per_side": settings.vertices_per_side,
            "time_step_s": settings.time_step_s,
            "frame_rate_hz": FRAME_RATE_HZ,
            "frames": int(np.ceil(training.recorded_s * FRAME_RATE_HZ)) + 2,
            "yaw_sd_deg": factor * usual.yaw_sd_deg,
            "height_sd_m": min(factor * usual.height_sd_m, 0.005),
            "fabric_sd_rel": min(factor * usual.fabric_sd_rel, 0.3),
            "curl_side": "drawn",
            "ideal_replicates": 0,
        }
    )


def film_size(settings: CaptureSettings) -> tuple[int, int]:
    """Width and height; the codec needs even numbers."""
    return settings.width_px // 2 * 2, settings.width_px * 3 // 8 * 2


def true_camera(config: Config) -> Camera:
    """The camera as it is."""
    place = turned(*viewpoint_pose("calibrated", config.render), CAMERA_TURN_DEG)
    width, height = film_size(config.captures)
    focal = _FOCAL_WIDTHS * width
    matrix = np.array([[focal, 0, 0.49 * width], [0, 1.006 * focal, 0.51 * height], [0, 0, 1.0]])
    distortion = np.array([LENS_K1, -0.4 * LENS_K1, 0.0008, -0.0006, 0.0])
    return Camera(*place, matrix, width, height, distortion)


def calibrated_camera(config: Config) -> Camera:
    """The same camera as a calibration would find it, with a calibration's errors."""
    true = true_camera(config)
    rng = generator(config.seed, "surrogate", "calibration")
    eye = -true.rotation.T @ true.translation_m + CAMERA_ERROR_M * rng.standard_normal(3)
    # An error of the place comes with one of the direction, which keeps the board where it was.
    tilt, _ = cv2.Rodrigues(CAMERA_ERROR_M / 1.4 * rng.standard_normal(3))
    rotation = tilt @ true.rotation
    matrix = true.matrix.copy()
    matrix[[0, 1], [0, 1]] *= 1 + 0.5 * CAMERA_ERROR_M * rng.standard_normal()
    wrong = 1 + 2 * CAMERA_ERROR_M * rng.standard_normal(5)
    return replace(
        true,
        rotation=rotation,
        translation_m=-rotation @ eye,
        matrix=matrix,
        distortion=np.asarray(true.distortion) * wrong,
    )


def surroundings(config: Config, pair: PairSettings) -> Surroundings:
    """Floor and lamp of a pair, drawn from what such floors look like."""
    rng = generator(config.seed, "surrogate", pair.material, pair.substrate)
    look = draw_look(pair.substrate, rng)
    lamp_m = LAMP_POSITION_M + rng.uniform(-0.15, 0.15, 3)
    return Surroundings(pair.substrate, *look, tuple(lamp_m.tolist()))


def slip_angles(config: Config) -> list[dict]:
    """Measurements of each pair by an inclined plane with its own error."""
    error_deg = INCLINE_ERROR_DEG
    rows = []
    for pair in config.captures.pairs:
        rng = generator(config.seed, "surrogate", "incline", pair.material, pair.substrate)
        bias_deg = rng.uniform(-error_deg, error_deg)
        for place in range(_PLACES):
            local = pair.friction * np.exp(FRICTION_SD_REL * rng.standard_normal())
            for orientation, share in _ORIENTATIONS.items():
                for repeat in range(1, _REPEATS + 1):
                    friction = local * (1 + share + _ANGLE_SCATTER * rng.standard_normal())
                    angle = np.degrees(np.arctan(friction)) + bias_deg
                    rows.append(
                        {
                            "material": pair.material,
                            "substrate": pair.substrate,
                            "position": f"position {place + 1}",
                            "orientation": orientation,
                            "repeat": repeat,
                            "angle_deg": f"{angle:.2f}",
                            "bench_error_deg": f"{error_deg:g}",
                        }
                    )
    return rows


def captures_rows(config: Config) -> list[dict]:
    """The captures table; friction is left to the reference measurement."""
    return [
        {
            "video": f"{film.id}.mp4",
            "material": film.pair.material,
            "substrate": film.pair.substrate,
            "repeat": film.repeat,
            "mu_ref": "",
            "mu_ref_error": "",
            "reflective": "yes" if FLOORS[film.pair.substrate].reflects_plainly else "no",
            "camera": "camera.json",
            "surrogate": "yes",
        }
        for film in films(config)
    ]


def write_bench(config: Config, folder: str | Path) -> None:
    """Write ``camera.json``, ``slip_angles.csv`` and ``captures.csv``; the videos come later."""
    started = start_clock()
    folder = Path(folder)
    tables = {"slip_angles.csv": slip_angles(config), "captures.csv": captures_rows(config)}
    record = provenance_record(
        "capture",
        config=config.model_dump(mode="json", include={"seed", "captures"}),
        seed=config.seed,
        started=started,
    )
    camera = camera_record(calibrated_camera(config)) | {"surrogate": True}
    write_camera_file(folder / "camera.json", camera)
    write_sidecar(folder / "camera.json", record)
    for name, rows in tables.items():
        write_text(folder / name, pandas.DataFrame(rows).to_csv(index=False), record)


def make_film(config: Config, film: Film, out: str | Path, progress=iter) -> int:
    """Simulate and render one capture as an MP4 file; return its number of frames."""
    started = start_clock()
    settings = surrogate_simulation(config)
    trajectory, _ = simulate_drop_and_drag(
        DropAndDrag(film.pair.material, film.friction, film.seed), settings
    )
    images = _lens_images(config, film, trajectory, progress)
    with atomic_path(out) as temporary:
        count = _write(config, film, images, temporary)
    record = provenance_record(
        "capture",
        config={"simulation": settings, "captures": config.captures, "film": film.id},
        seed=film.seed,
        started=started,
    )
    # Every surrogate video is labelled.
    write_sidecar(out, {**record, "surrogate": True})
    return count


def filmed(time_s: np.ndarray, path: StagePath, later_every: int) -> np.ndarray:
    """Which of a simulation's frames are filmed: all where a film's clock is read, else a few.

    That is while the stage starts, and where it rests between drop and drag.
    """
    few = np.arange(len(time_s)) % later_every == 0
    return np.flatnonzero((time_s <= _START_S) | is_at_rest(time_s, path) | few)


def _lens_images(
    config: Config, film: Film, trajectory: Trajectory, progress
) -> Iterator[tuple[float, np.ndarray]]:
    """Time and linear light (rows, columns, 3) of the recorded frames, as projected by the lens."""
    lens = true_camera(config)
    pinhole, place = _pinhole(lens)
    path = StagePath(**dict(config.simulation.stage))
    shots = [
        Shot(int(row), int(trajectory.frame[row]), float(trajectory.time_s[row]), pinhole)
        for row in filmed(trajectory.time_s, path, config.captures.later_every)
    ]
    render = config.render.model_copy(update={"pixels": pinhole.pixels})
    frames = render_shadings(trajectory, progress(shots), render, surroundings(config, film.pair))
    for shot, shading, sight in frames:
        (light,) = compose_light(join(shading, sight), [film.pair.texture])
        seen = cv2.remap(light.astype(np.float32), place, None, cv2.INTER_CUBIC)
        yield shot.time_s, np.maximum(seen, 0)


def _pinhole(camera: Camera) -> tuple[Camera, np.ndarray]:
    """A square pinhole image that holds the lens's, and where in it the lens looks."""
    side = round(_MARGIN * camera.pixels)
    matrix = camera.matrix.copy()
    # One focal length: what the renderer draws has square pixels.
    matrix[1, 1] = matrix[0, 0]
    matrix[0, 2] += (side - camera.pixels) / 2
    matrix[1, 2] += (side - camera.size_px[1]) / 2
    pinhole = Camera(camera.rotation, camera.translation_m, matrix, side)
    y, x = np.mgrid[: camera.rows, : camera.pixels].astype(np.float64)
    pixels = np.stack([x, y], axis=-1).reshape(-1, 1, 2)
    until = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-9)
    at = cv2.undistortPointsIter(pixels, camera.matrix, camera.distortion, None, matrix, until)
    return pinhole, at.reshape(camera.rows, camera.pixels, 2).astype(np.float32)


def _write(config: Config, film: Film, images, path) -> int:
    """The video: rest, then frames with drifting exposure, sensor noise and H.264 compression."""
    rng = generator(config.seed, "surrogate", film.id, "camera")
    red, blue = 1 + COLOUR_CAST * rng.uniform(-1, 1, 2)
    drift, phase = EXPOSURE_DRIFT_STOPS * rng.uniform(-1, 1), rng.uniform(0, 2 * np.pi)
    duration_s = config.simulation.recorded_s + _REST_S
    count = 0
    with av.open(str(path), "w", format="mp4") as container:
        options = {"crf": QUALITY_CRF, "preset": "medium", "threads": "1"}
        stream = container.add_stream("libx264", rate=30, options=options)
        stream.width, stream.height = film_size(config.captures)
        stream.pix_fmt = "yuv420p"
        stream.time_base = stream.codec_context.time_base = _CLOCK
        container.metadata["comment"] = "Slipstitch surrogate capture: simulated, not real"
        for time_s, light in _after_rest(images):
            share = time_s / duration_s
            stops = drift * share + 0.2 * EXPOSURE_DRIFT_STOPS * np.sin(9 * share + phase)
            camera = CameraEffects(float(stops), float(red), float(blue), NOISE)
            image = np.ascontiguousarray(camera.photograph(light, rng))
            frame = av.VideoFrame.from_ndarray(image, format="rgb24")
            frame.pts, frame.time_base = round(time_s / _CLOCK), _CLOCK
            container.mux(stream.encode(frame))
            count += 1
        container.mux(stream.encode())
    return count


def _after_rest(images) -> Iterator[tuple[float, np.ndarray]]:
    """Time in the video, and light: the image at the start shows the rest before it, too."""
    rest = int(_REST_S * FRAME_RATE_HZ)
    for time_s, light in images:
        if time_s == 0:
            yield from ((k / FRAME_RATE_HZ, light) for k in range(rest))
        yield rest / FRAME_RATE_HZ + time_s, light
