"""How well a film tells the height of the clamps: rendered films of known heights.

    python studies/clamp_height.py SIMULATIONS --films 12 --out film_height.json

SIMULATIONS is a folder of trajectories (a release, or results/simulate). The clamps of each film
are lifted by -2 ... 2 mm, with the cloth as far as the cloth hangs from them; cloth, texture,
floor, lamp and camera differ, and the images have noise, compression and a drifting exposure. Each
film is read with the camera as it was rendered, and with two that are calibrated on a board on the
floor, whose place is told with an error of 0.5 mm, its thickness of 0.2 mm, its corners of 0.1
pixel, behind a focal length with an error of 0.05 %. A study: asked once, not maintained.
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from slipstitch.base.provenance import provenance_record, recorded_path, start_clock
from slipstitch.config import resolve_config
from slipstitch.config.catalogue import VIEWPOINTS
from slipstitch.film.camera_calibration import FloorPlace
from slipstitch.film.edge_height import EdgeFinder
from slipstitch.film.frame_schedule import Schedule
from slipstitch.film.measure.clamp_height import EXACT_M
from slipstitch.images.calibrated_view import BenchCamera
from slipstitch.images.camera import Camera, pose
from slipstitch.images.composition import compose_light, join
from slipstitch.images.encoding import encode_srgb
from slipstitch.images.packing import render_shadings
from slipstitch.images.surroundings import LAMP_POSITION_M, Surroundings, draw_look
from slipstitch.images.view import Shot
from slipstitch.physics.simulation.trajectory import read_trajectory

CONFIG = resolve_config({})
LIFTED_MM = (-2.0, -1.0, 0.0, 1.0, 2.0)
TIMES_S = (7.08, 25.0, 31.0, 37.5)  # at rest, then with the stage far ahead
FLOORS = (*CONFIG.render.floors, "smooth-glass", "ceramic")
PLACE = np.array([50.0, -60.0, 0.0, 3.0])  # mm, mm, degrees, mm
PLACE_SD = np.array([0.5, 0.5, 0.1, 0.2])
CORNER_PX, FOCAL_SD = 0.1, 5e-4
CAMERA_MM = 0.36  # of such a calibration, as `slipstitch capture camera` states it


def lifted(trajectory, lift_m):
    """Return the trajectory with higher clamps; the cloth follows by its height."""
    share = np.clip(trajectory.positions_m[..., 2] / trajectory.stage_z_m[:, None], 0.0, 1.0)
    positions_m = trajectory.positions_m.copy()
    positions_m[..., 2] += lift_m * share
    return replace(trajectory, positions_m=positions_m, stage_z_m=trajectory.stage_z_m + lift_m)


def bench_camera(rng, pixels):
    """Return a camera beside the calibrated viewpoint."""
    yaw, pitch, roll, distance = rng.uniform(-1, 1, 4) * [12, 6, 2, 0.15]
    bench = BenchCamera(yaw_deg=yaw, pitch_deg=pitch, roll_deg=roll, distance=1 + distance)
    matrix = np.array([[1.72 * pixels, 0, pixels / 2], [0, 1.72 * pixels, pixels / 2], [0, 0, 1]])
    return Camera(*bench.pose(*pose(VIEWPOINTS["calibrated"])), matrix, pixels)


def film(trajectory, camera, floor, texture, rng):
    """Return times and images of the frames that tell the height."""
    lamp_m = np.array(LAMP_POSITION_M) + rng.uniform(-0.15, 0.15, 3)
    surroundings = Surroundings(floor, *draw_look(floor, rng), tuple(lamp_m))
    settings = CONFIG.render.model_copy(update={"pixels": camera.pixels})
    rows = [int(np.abs(trajectory.time_s - time_s).argmin()) for time_s in TIMES_S]
    shots = [
        Shot(row, int(trajectory.frame[row]), float(trajectory.time_s[row]), camera) for row in rows
    ]
    frames = []
    for shot, shading, sight in render_shadings(trajectory, shots, settings, surroundings):
        (light,) = compose_light(join(shading, sight), [texture])
        for _ in range(2):
            image = encode_srgb(np.clip(light * 2 ** (0.1 * rng.normal()), 0, 1)).astype(float)
            image = np.clip(image + 3 * rng.normal(size=image.shape), 0, 255).astype(np.uint8)
            _, packed = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])
            frames.append((shot.time_s, cv2.imdecode(packed, cv2.IMREAD_COLOR)))
    return frames


def calibrated(camera, rng):
    """Return the camera as a board on the floor would calibrate it."""
    x, y = np.meshgrid(np.arange(1, 10) * 0.02, np.arange(1, 7) * 0.02)
    board = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    corners = camera.project(FloorPlace(*PLACE).on_stage(board))
    corners += CORNER_PX * rng.normal(size=corners.shape)
    told = FloorPlace(*(PLACE + PLACE_SD * rng.normal(size=4))).on_stage(board)
    matrix = camera.matrix.copy()
    matrix[[0, 1], [0, 1]] *= 1 + FOCAL_SD * rng.normal()
    _, rotation, translation_m = cv2.solvePnP(told, corners, matrix, np.zeros(5))
    return Camera(cv2.Rodrigues(rotation)[0], translation_m.ravel(), matrix, camera.pixels)


def found(frames, camera):
    """Return what the film tells behind a camera, or None."""
    finder = EdgeFinder(camera, Schedule.of(CONFIG))
    for time_s, image in frames:
        finder.add(time_s, image)
    return finder.found()


def summary(errors_mm, stated_mm):
    """Return bias, root mean square and largest error; the root mean square of those stated.

    Of the films whose stated error is so small that they would correct a reading.
    """
    corrects = np.array(stated_mm) < 1e3 * EXACT_M
    errors_mm, stated_mm = np.array(errors_mm)[corrects], np.array(stated_mm)[corrects]
    return {
        "would_not_correct": int((~corrects).sum()),
        "estimates": len(errors_mm),
        "bias_mm": float(errors_mm.mean()),
        "rms_mm": float(np.sqrt((errors_mm**2).mean())),
        "largest_mm": float(np.abs(errors_mm).max()),
        "stated_rms_mm": float(np.sqrt(np.mean(np.square(stated_mm)))),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("simulations", type=Path)
    parser.add_argument("--films", type=int, default=12)
    parser.add_argument("--pixels", type=int, default=480)
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    started = start_clock()
    files = sorted(arguments.simulations.rglob("m*_f*.parquet"))
    told = {"camera_known": ([], []), "camera_calibrated": ([], [])}
    without = 0
    for number in range(arguments.films):
        rng = np.random.default_rng(number)
        trajectory = read_trajectory(files[int(rng.integers(len(files)))])
        lift_mm = LIFTED_MM[number % len(LIFTED_MM)]
        camera = bench_camera(rng, arguments.pixels)
        texture = CONFIG.render.textures[number % len(CONFIG.render.textures)]
        floor = FLOORS[number % len(FLOORS)]
        trajectory = lifted(trajectory, 1e-3 * lift_mm)
        frames = film(trajectory, camera, floor, texture, rng)
        height_mm = 1e3 * trajectory.stage_z_m[np.abs(trajectory.time_s - TIMES_S[0]).argmin()]
        cameras = [calibrated(camera, rng) for _ in range(2)]
        for name, lens in (("camera_known", camera), *(("camera_calibrated", c) for c in cameras)):
            edge = found(frames, lens)
            if edge is None:
                without += 1
                continue
            errors_mm, stated_mm = told[name]
            errors_mm.append(1e3 * edge.height_m - height_mm)
            of_camera_mm = 0.0 if lens is camera else CAMERA_MM
            stated_mm.append(float(np.hypot(1e3 * edge.error_m, of_camera_mm)))
            print(f"{number} {name} {errors_mm[-1]:+.2f} ± {stated_mm[-1]:.2f} mm", flush=True)
    result = {name: summary(*errors) for name, errors in told.items()}
    films = {"films": arguments.films, "pixels": arguments.pixels}
    record = provenance_record("capture", inputs=[], config=films, started=started)
    with recorded_path(arguments.out, record) as temporary:
        text = json.dumps(result | films | {"without_an_edge": without}, indent=1) + "\n"
        temporary.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
