"""A surrogate video: simulated, rendered, distorted by a lens, exposed, compressed."""

import os
from collections.abc import Iterator
from fractions import Fraction

import cv2
import numpy as np

from slipstitch.base.provenance import atomic_path, provenance_record, start_clock, write_sidecar
from slipstitch.config import Config
from slipstitch.film.surrogate_bench import (
    FRAME_RATE_HZ,
    Film,
    film_size,
    surrogate_simulation,
    surroundings,
    true_camera,
)
from slipstitch.images.camera import Camera
from slipstitch.images.camera_effects import CameraEffects
from slipstitch.images.composition import compose_light, join
from slipstitch.images.packing import render_shadings
from slipstitch.images.shots import Shot
from slipstitch.images.surroundings import generator
from slipstitch.physics.simulation.drop_and_drag import DropAndDrag, simulate_drop_and_drag
from slipstitch.physics.simulation.trajectory import Trajectory

# The cloth hangs still for this long; the stage's start is filmed at the full rate for that long.
# What a consumer camera does to a video.
EXPOSURE_DRIFT_STOPS = 0.25
COLOUR_CAST = 0.06  # scaling of red and blue
NOISE = 0.02  # as render.augmentation.noise
QUALITY_CRF = "26"  # constant rate factor of H.264

_REST_S = 3.4
_START_S = 3.0
# What the lens pulls in from beyond the pinhole's image.
_MARGIN = 1.12
_CLOCK = Fraction(1, 90000)


def make_film(config: Config, film: Film, out: str | os.PathLike, progress=iter) -> int:
    """Simulate and render one capture.

    Parameters
    ----------
    config : Config
    film : Film
    out : path
        Video, MP4.
    progress : callable
        Wraps the list of frames that are rendered.

    Returns
    -------
    int
        Frames of the film.

    Raises
    ------
    NotConverged
        If the simulation cannot be solved.
    """
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


def _lens_images(
    config: Config, film: Film, trajectory: Trajectory, progress
) -> Iterator[tuple[float, np.ndarray]]:
    """Time and linear light (rows, columns, 3) of the recorded frames, as projected by the lens."""
    lens = true_camera(config, film.id)
    pinhole, place = _pinhole(lens)
    dense = trajectory.time_s <= _START_S
    later = (np.arange(len(trajectory.frame)) % config.captures.later_every == 0) | dense
    shots = [
        Shot(int(row), int(trajectory.frame[row]), float(trajectory.time_s[row]), pinhole)
        for row in np.flatnonzero(later)
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
    import av

    rng = generator(config.seed, "surrogate", film.id, "camera")
    red, blue = 1 + COLOUR_CAST * rng.uniform(-1, 1, 2)
    drift, phase = EXPOSURE_DRIFT_STOPS * rng.uniform(-1, 1), rng.uniform(0, 2 * np.pi)
    duration_s = config.simulation.recorded_s + _REST_S

    def photograph(light: np.ndarray, time_s: float) -> np.ndarray:
        share = time_s / duration_s
        stops = drift * share + 0.2 * EXPOSURE_DRIFT_STOPS * np.sin(9 * share + phase)
        camera = CameraEffects(float(stops), float(red), float(blue), NOISE)
        return camera.photograph(light, rng)

    count = 0
    with av.open(str(path), "w", format="mp4") as container:
        options = {"crf": QUALITY_CRF, "preset": "medium", "threads": "1"}
        stream = container.add_stream("libx264", rate=30, options=options)
        stream.width, stream.height = film_size(config.captures)
        stream.pix_fmt = "yuv420p"
        stream.time_base = stream.codec_context.time_base = _CLOCK
        container.metadata["comment"] = "Slipstitch surrogate capture: simulated, not real"

        def add(light: np.ndarray, time_s: float) -> None:
            nonlocal count
            image = np.ascontiguousarray(photograph(light, time_s))
            frame = av.VideoFrame.from_ndarray(image, format="rgb24")
            frame.pts, frame.time_base = round(time_s / _CLOCK), _CLOCK
            container.mux(stream.encode(frame))
            count += 1

        rest = int(_REST_S * FRAME_RATE_HZ)
        for time_s, light in images:
            if time_s == 0:
                for k in range(rest):
                    add(light, k / FRAME_RATE_HZ)
            add(light, rest / FRAME_RATE_HZ + time_s)
        container.mux(stream.encode())
    return count
