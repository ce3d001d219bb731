"""The surrogate bench: its camera, its inclined plane, variation between videos.

Nothing of it is known to the networks, and only what a real bench would write down is handed on: a
calibrated camera with its errors, slip angles, a table of videos.
"""

import os
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pandas

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import provenance_record, recorded_path, start_clock, write_sidecar
from slipstitch.config import Config
from slipstitch.config.captures import CaptureSettings, PairSettings
from slipstitch.config.catalogue import FLOORS
from slipstitch.config.simulation import SimulationSettings
from slipstitch.design.grid import simulation_seed
from slipstitch.images.bench_camera import draw_bench_camera
from slipstitch.images.calibrated_view import viewpoint_pose
from slipstitch.images.camera import Camera, turned
from slipstitch.images.camera_file import camera_record, write_camera_file
from slipstitch.images.surroundings import LAMP_POSITION_M, Surroundings, draw_look, generator

# With this focal length (in image widths) the whole travel is in the image.
# A bench is less exact than training's: what it varies by between videos, and is wrong by.
BENCH_VARIATION = 1.5  # of clamps and fabric, times the defaults of the section simulation
FRICTION_SD_REL = 0.03  # between positions on a substrate
INCLINE_ERROR_DEG = 0.3  # largest, of the inclined plane's angle
CAMERA_TURN_DEG = 2.0  # from the viewpoint
CAMERA_ERROR_M = 0.001  # of the position in the camera file, along each axis
LENS_K1 = -0.12  # barrel distortion of a cheap lens
FRAME_RATE_HZ = 12.0  # while the stage starts

_FOCAL_WIDTHS = 1.72
_ZOOM_MARGIN = 0.93  # so that it still is from 15 degrees aside
_FAMILY_VIEWPOINT = "bench_1"
_PLACES, _REPEATS = 4, 2
_ORIENTATIONS = {"warp": 0.01, "weft": -0.01}
_ANGLE_SCATTER = 0.02


@dataclass(frozen=True)
class Film:
    """One surrogate capture.

    Attributes
    ----------
    id : str
    pair : PairSettings
    repeat : int
    friction : float
        Where the fabric lay this time.
    seed : int
        Of the clamps and the fabric.
    """

    id: str
    pair: PairSettings
    repeat: int
    friction: float
    seed: int


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
    duration_s = training.recorded_s
    # Not in units of the training's own variation: that of the paper's experiment is none.
    factor, usual = BENCH_VARIATION, SimulationSettings()
    return training.model_copy(
        update={
            "vertices_per_side": settings.vertices_per_side,
            "time_step_s": settings.time_step_s,
            "frame_rate_hz": FRAME_RATE_HZ,
            "frames": int(np.ceil(duration_s * FRAME_RATE_HZ)) + 2,
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


def true_camera(config: Config, film: str) -> Camera:
    """The true camera of the video with id `film`."""
    settings = config.captures
    place = viewpoint_pose("calibrated", config.render)
    width, height = film_size(settings)
    focal = _FOCAL_WIDTHS * width
    if settings.own_cameras:
        # A seed apart from the training's: cameras that no network has seen.
        bench = draw_bench_camera(
            config.render, config.seed + 1, f"surrogate {film}", _FAMILY_VIEWPOINT
        )
        place = bench.pose(*place)
        focal *= _ZOOM_MARGIN * bench.distance
    else:
        place = turned(*place, CAMERA_TURN_DEG)
    matrix = np.array([[focal, 0, 0.49 * width], [0, 1.006 * focal, 0.51 * height], [0, 0, 1.0]])
    k1 = LENS_K1
    distortion = np.array([k1, -0.4 * k1, 0.0008, -0.0006, 0.0])
    return Camera(*place, matrix, width, height, distortion)


def calibrated_camera(config: Config, film: str) -> Camera:
    """The same camera as a calibration would find it, with a calibration's errors."""
    true = true_camera(config, film)
    own = [film] if config.captures.own_cameras else []
    rng = generator(config.seed, "surrogate", "calibration", *own)
    error_m = CAMERA_ERROR_M
    eye = -true.rotation.T @ true.translation_m + error_m * rng.standard_normal(3)
    # An error of the place comes with one of the direction, which keeps the board where it was.
    tilt, _ = cv2.Rodrigues(error_m / 1.4 * rng.standard_normal(3))
    rotation = tilt @ true.rotation
    matrix = true.matrix.copy()
    matrix[[0, 1], [0, 1]] *= 1 + 0.5 * error_m * rng.standard_normal()
    return replace(
        true,
        rotation=rotation,
        translation_m=-rotation @ eye,
        matrix=matrix,
        distortion=np.asarray(true.distortion) * (1 + 2 * error_m * rng.standard_normal(5)),
    )


def surroundings(config: Config, pair: PairSettings) -> Surroundings:
    """Floor and lamp of a pair, drawn from what such floors look like."""
    rng = generator(config.seed, "surrogate", pair.material, pair.substrate)
    look = draw_look(pair.substrate, rng)
    x, y, z = np.array(LAMP_POSITION_M) + rng.uniform(-0.15, 0.15, 3)
    return Surroundings(pair.substrate, *look, (x, y, z))


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
            "camera": camera,
            "surrogate": "yes",
        }
        for film, camera in zip(films(config), config.captures.camera_files(), strict=True)
    ]


def write_bench(config: Config, folder: str | os.PathLike) -> None:
    """Write camera files, ``slip_angles.csv`` and ``captures.csv``; the videos come later."""
    started = start_clock()
    folder = Path(folder)
    tables = {"slip_angles.csv": slip_angles(config), "captures.csv": captures_rows(config)}
    record = provenance_record(
        "capture",
        config=config.model_dump(mode="json", include={"seed", "captures"}),
        seed=config.seed,
        started=started,
    )
    settings = config.captures
    of_file = dict(zip(settings.camera_files(), settings.surrogate_ids(), strict=True))
    for name, film in of_file.items():
        record_of = camera_record(calibrated_camera(config, film))
        write_camera_file(folder / name, record_of | {"surrogate": True})
        write_sidecar(folder / name, record)
    for name, rows in tables.items():
        with recorded_path(folder / name, record) as temporary:
            pandas.DataFrame(rows).to_csv(temporary, index=False)
