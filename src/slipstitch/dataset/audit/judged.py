"""The calibration judged again from its runs, the verification drawn and compared again."""

import base64
import math
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from slipstitch.base.errors import first_line
from slipstitch.base.provenance import read_json
from slipstitch.config import Config
from slipstitch.config.calibrate import BASE, KEYS
from slipstitch.config.load import without_law
from slipstitch.dataset.audit.admission import UNUSABLE
from slipstitch.dataset.audit.contents import Contents
from slipstitch.dataset.audit.files import Shard
from slipstitch.dataset.audit.findings import Finding, Kind
from slipstitch.dataset.audit.png import png_problem
from slipstitch.dataset.release.currency import CALIBRATION
from slipstitch.dataset.release.records import VERIFICATION, carried_file
from slipstitch.design.sampled_frames import sampled_frames
from slipstitch.physics import theory
from slipstitch.physics.calibration.calibration import chosen_simulation, verified_settings
from slipstitch.physics.calibration.choice import COMBINATION, judge, may_be_chosen
from slipstitch.physics.calibration.experiments import experiments
from slipstitch.physics.calibration.sweep import variations

_NEAR = 1e-9
# A released image beside the composed one: noise and compression of its camera lie between.
_AS_PHOTOGRAPHED_DB = 20.0


def check_judged(
    contents: Contents, config: Config, shards: Mapping[str, Shard], stale: set[str]
) -> Iterator[Finding]:
    """Findings of kind BROKEN in calibration and verification, where their code has not changed.

    Parameters
    ----------
    contents : Contents
    config : Config
    shards : mapping
        What `slipstitch.dataset.audit.files.check_files` read.
    stale : set of str
        Stages whose code has changed since.
    """
    every = tuple(contents.clips)
    for path, artefact in sorted(contents.artefacts.items()):
        place = contents.folder / carried_file(path)
        check = None
        if Path(path).name == CALIBRATION and "calibrate.calibration" not in stale:
            check = partial(_calibration, config=config)
        elif path == VERIFICATION and "render" not in stale:
            check = partial(_verification, contents=contents, config=config, shards=shards)
        if check is None or not artefact.provenance or not place.is_file():
            continue
        try:
            problems = list(check(read_json(place)))
        except UNUSABLE as error:
            problems = [f"cannot be checked: {first_line(error)}"]
        for problem in problems:
            yield Finding(Kind.BROKEN, carried_file(path), problem, every)


def _calibration(content: Mapping[str, Any], config: Config) -> Iterator[str]:
    """Checks and choice, from the runs that the calibration holds."""
    simulation = config.simulation
    runs = content["experiments"]
    planned = experiments()
    options = [(one.protocol, one.options) for one in planned]
    if [(run["protocol"], run["options"]) for run in runs] != options:
        yield "its experiments do not match the configuration"
        return
    judged = []
    for experiment, run in zip(planned, runs, strict=True):
        result = run["result"]
        judged += experiment.run(lambda *_, result=result: result)[0]
        for key, value in _theory(experiment.protocol, experiment.options).items():
            if abs(result[key] - value) > _NEAR * max(1.0, abs(value)):
                yield f"{experiment.describe()}: {key} is {result[key]:g}, theory says {value:g}"
    if content["checks"] != [check.as_dict() for check in judged]:
        pairs = zip(content["checks"], judged, strict=False)
        odd = next((check.describe() for stated, check in pairs if stated != check.as_dict()), None)
        yield f"its checks do not match its runs: {odd or 'a different number'}"
    for check in judged:
        if not check.met:
            yield f"a requirement is not met: {check.describe()}"
        elif check.demand > 0 and check.error == 0 and check.theory:
            yield f"{check.name}: a simulation that agrees with theory to the last bit"
    if content["met"] is not all(check.met for check in judged):
        yield "states wrongly that its requirements are met"
    strip = content["strip"]
    configured = verified_settings(chosen_simulation(simulation, strip))
    if without_law(content["settings"]) != configured:
        yield "its settings are not the configured ones combined with those chosen by the strip"
    yield from _strip(strip, config)


def _theory(protocol: str, options: Mapping[str, float]) -> dict[str, float]:
    friction = options["friction"]
    if protocol == "incline":
        slope = math.radians(options["slope_deg"])
        expected = theory.incline(friction, slope).acceleration_m_s2
        return {"theory_acceleration_m_s2": expected}
    if protocol == "flat-drag":
        return {"theory_pull_over_weight": float(theory.flat_drag(friction))}
    drag = theory.steady_strip_drag(
        friction, 0.2, 0.15, options["gravity_length_m"], holder_angle_rad=None
    )
    keys = ("pull_over_w_m", "holder_ahead_of_tail_m")
    return {f"theory_{key}": getattr(drag, key) for key in keys}


def _strip(strip: Mapping[str, Any], config: Config) -> Iterator[str]:
    """Every setting that was tried, judged again."""
    settings, trials = config.calibrate, strip["trials"]
    expected = [
        (key, tried)
        for key in (BASE, *KEYS)
        for tried in variations(key, settings, config.simulation)
    ]
    if [(one["key"], one["settings"]) for one in trials if one["key"] != COMBINATION] != expected:
        yield "the settings of its strip do not match the configuration"
        return
    base = trials[0]["settings"]
    for trial in trials:
        again = judge(trial)
        again["distance"] = again["distance"] if math.isfinite(again["distance"]) else None
        again["may_be_chosen"] = may_be_chosen(trial, base)
        if again != trial:
            odd = next(key for key in again if again[key] != trial.get(key))
            yield f"the {odd} of a strip with {trial['key']} changed is not that of its runs"
    chosen = strip["chosen"]
    same = [one for one in trials if one["settings"] == chosen["settings"]]
    if not any(one["meets"] and one["may_be_chosen"] for one in same):
        yield "the settings that it chose are not eligible or do not meet the requirements"
    elif not any(_as_tried(chosen, one) for one in same):
        yield "its data on the chosen settings do not match their trial"


def _as_tried(chosen: Mapping[str, Any], trial: Mapping[str, Any]) -> bool:
    keys = ("strain_error", "friction_error", "wrong_regimes", "distance", "meets")
    return all(chosen[key] == trial[key] for key in keys)


def _verification(
    content: Mapping[str, Any], contents: Contents, config: Config, shards: Mapping[str, Shard]
) -> Iterator[str]:
    """Which images were compared, and what the comparison of their pictures gives."""
    from slipstitch.images.verification import LEAST_PSNR_DB, LEAST_SSIM, psnr_db, ssim

    compared = content["comparisons"]
    if [(one["video"], one["frame"]) for one in compared] != _drawn(config):
        yield "its images are not those drawn from the seed"
        return
    lowest = {key: min((one[key] for one in compared), default=None) for key in ("psnr_db", "ssim")}
    summed = {"images": len(compared), **{f"lowest_{key}": value for key, value in lowest.items()}}
    if {key: value for key, value in content.items() if key != "comparisons"} != summed:
        yield "its lowest values do not match its images"
    for one in compared:
        where = f"{one['video']} frame {one['frame']}"
        row = contents.row_of[one["video"]]
        least = LEAST_PSNR_DB[row["floor_reflectance"] > 0]
        if (one["floor"], one["least_psnr_db"]) != (row["floor"], least):
            yield f"{where}: floor or limit do not match the clip"
        images = [_decoded(one[key]) for key in ("composed_png", "direct_png")]
        if images[0].shape != images[1].shape:
            yield f"{where}: its two images have different sizes"
            continue
        again = {"psnr_db": psnr_db(*images), "ssim": ssim(*images)}
        for key, value in again.items():
            if not abs(one[key] - value) <= _NEAR * abs(value):
                yield f"{where}: its {key} is {one[key]:.6g}, that of the two images {value:.6g}"
        good = again["psnr_db"] >= least and again["ssim"] >= LEAST_SSIM
        if not (good and one["as_stored"] is True and one["passed"] is True):
            yield f"{where}: deviates too much from the direct render"
        released = _released(contents, one, shards)
        if released is not None and not _photographed(contents, config, one, released, images[0]):
            yield f"{where}: the compared image is not the released one"


def _drawn(config: Config) -> list[tuple[str, int]]:
    """Video and frame of the images that the seed draws for verification."""
    from slipstitch.design.grid import films
    from slipstitch.images.verification import drawn_rows

    total = config.simulation.frames
    frames = (
        np.arange(total)
        if config.render.frames == "all"
        else sampled_frames(total, config.sample.frames_kept)
    )
    rows = [
        (f"{simulation}_{texture}_{view}", int(frame))
        for (simulation, view), textures in sorted(films(config).items())
        for frame in frames
        for texture in textures
    ]
    drawn = drawn_rows(config.seed, config.render.verified_images, len(rows))
    return [rows[row] for row in drawn]


def _decoded(text: str) -> np.ndarray:
    """Image (rows, columns, 3) uint8, red first."""
    data = base64.b64decode(text, validate=True)
    problem = png_problem(data)
    if problem:
        raise ValueError(f"an image {problem}")
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]


def _released(
    contents: Contents, one: Mapping[str, Any], shards: Mapping[str, Shard]
) -> np.ndarray | None:
    """The image as it is in the release; None where the dataset leaves its frame out."""
    from slipstitch.dataset.release.previews import reader

    row = contents.row_of[one["video"]]
    shard = shards.get(row["shard"])
    if shard is None or shard.problem or shard.flaws or one["video"] not in shard.columns:
        return None
    frames = shard.columns[one["video"]]["frame"]
    if one["frame"] not in frames:
        return None
    return reader(contents.folder)(row, frames.index(one["frame"]))


def _photographed(
    contents: Contents, config: Config, one, released: np.ndarray, composed: np.ndarray
) -> bool:
    """Whether the camera of a clip can have made the released image of the composed one."""
    from slipstitch.dataset.audit.cameras import Cameras
    from slipstitch.design.grid import find_simulation
    from slipstitch.images.camera_effects import draw_camera_effects
    from slipstitch.images.verification import psnr_db

    row = contents.row_of[one["video"]]
    simulation = find_simulation(config, row["simulation"])
    cameras = Cameras(contents, config, simulation, row["viewpoint_id"])
    shot = next(shot for shot in cameras.shots if shot.frame == one["frame"])
    if composed.shape[1::-1] != shot.camera.size_px:
        return False
    expected = cameras.rectify.at(shot.camera, shot.time_s)(composed)
    words = (row["simulation"], row["texture"], row["viewpoint"])
    camera = draw_camera_effects(config.render.augmentation, config.seed, *words)
    if camera.noise == 0 and camera.jpeg_quality == 100:
        return np.array_equal(released, expected)
    return psnr_db(released, expected) >= _AS_PHOTOGRAPHED_DB
