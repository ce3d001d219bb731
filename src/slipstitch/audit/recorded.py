"""What every record says, against what configuration, seeds and the other records give.

Where the code of a stage has not changed, nothing in a record is left to faith but what only the
job itself could measure: times, the machine, how many iterations a solver took. Of these it is
asked whether they are possible.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np

from slipstitch.audit.admission import UNUSABLE
from slipstitch.audit.contents import Contents
from slipstitch.audit.findings import Finding, Kind
from slipstitch.audit.lineage import SAMPLED_MANIFEST, Lineage
from slipstitch.bench.stage_path import SIDE_M, TAB_M
from slipstitch.config import Config
from slipstitch.config.grid import Simulation, films, simulations
from slipstitch.config.interpolation import interpolations
from slipstitch.config.simulation import SimulationSettings
from slipstitch.errors import first_line
from slipstitch.release.code import CODE, locked_versions
from slipstitch.release.currency import CALIBRATION, calibrated_simulation, other_versions
from slipstitch.release.records import VERIFICATION, Artefact, is_ours, record_file

# Where a stage writes; the first that fits.
STAGES = {
    "results/calibrate/": "calibrate",
    "results/simulate/": "simulate",
    "results/render/shading/": "render.packing",
    "results/render/": "render",
    "results/sample/": "sample",
}
# Keys of a section that a record need not hold: what its file does not depend on.
_NOT_NEEDED = {
    "render": {
        *("threads", "verified_images", "textures", "test_textures", "viewpoints"),
        *("test_viewpoints", "test_viewpoint_videos", "augmentation"),
        *("floors", "reflective_floors"),  # what was drawn of them is in the metadata
    }
}
_SECTIONS = {
    "calibrate": ("simulation", "calibrate"),
    "simulate": ("simulation",),
    "render": ("render",),
    "render.packing": ("render",),
    "sample": ("grid", "render", "sample"),
}
_NEAR = 1e-9
# A step ends when its residual is below the tolerance: of many, one ends closely below.
_LARGEST_RESIDUAL_SHARE = 0.1
_MANY_STEPS = 100


def check_recorded(lineage: Lineage, config: Config, stale: set[str]) -> Iterator[Finding]:
    """Everything in the records that can be computed.

    Parameters
    ----------
    lineage : Lineage
    config : Config
        The release's.
    stale : set of str
        Stages whose code has changed since: what they write is not computed.

    Yields
    ------
    Finding
        Of kind BROKEN.
    """
    contents = lineage.contents
    grid = {simulation.id: simulation for simulation in simulations(config)}
    lock = locked_versions(contents.folder / CODE)
    checks = {"simulate": _simulated, "render": _rendered, "render.packing": _rendered}
    for path, artefact in sorted(lineage.artefacts.items()):
        if not is_ours(path) or artefact.provenance is None:
            continue
        stage = next((name for start, name in STAGES.items() if path.startswith(start)), None)
        if stage != artefact.stage:
            yield _broken(lineage, artefact, f"names {artefact.stage!r} as its stage")
            continue
        problems = list(other_versions(artefact.record, lock))
        try:
            problems += _made_with(artefact, config, grid)
            if stage not in stale and path != VERIFICATION and stage in checks:
                problems += checks[stage](artefact, contents, config, grid)
        except UNUSABLE as error:
            problems.append(f"cannot be traced: {first_line(error)}")
        for problem in problems:
            yield _broken(lineage, artefact, problem)


def _broken(lineage: Lineage, artefact: Artefact, what: str) -> Finding:
    return Finding(Kind.BROKEN, record_file(artefact.path), what, lineage.clips(artefact.path))


def _simulation_of(artefact: Artefact, grid: Mapping[str, Simulation]) -> Simulation:
    name = "_".join(Path(artefact.path).stem.split("_")[:3])
    if name not in grid:
        raise ValueError(f"{name} is not in the configured grid")
    return grid[name]


def _made_with(artefact: Artefact, config: Config, grid: Mapping[str, Simulation]) -> Iterator[str]:
    """Whether no key of a section is left out, and the seed."""
    recorded = artefact.record["config"]
    plain = config.model_dump(mode="json")
    for section in _SECTIONS[artefact.stage]:
        found = recorded.get(section)
        keys = set(found) if isinstance(found, Mapping) else set()
        missing = set(plain[section]) - keys - _NOT_NEEDED.get(section, set())
        if missing:
            yield f"does not state the {section}.{min(missing)} it was made"
        if keys - set(plain[section]):
            yield f"was made with {section}.{min(keys - set(plain[section]))}: no such key"
    seed: int | None = config.seed
    if artefact.stage == "simulate":
        seed = _simulation_of(artefact, grid).seed
    elif artefact.stage == "calibrate":
        seed = None
    if artefact.record.get("seed") != seed:
        yield f"its seed is {artefact.record.get('seed')!r}, the configuration gives {seed!r}"
    made_from = {name for name in artefact.inputs if is_ours(name)}
    needed = _inputs(artefact, config, grid)
    if needed is not None and {name for name in made_from if "/shading/" not in name} != needed:
        odd = min(made_from ^ needed)
        yield f"was made {'from' if odd in made_from else 'without'} {odd}"


def _inputs(artefact: Artefact, config: Config, grid: Mapping[str, Simulation]) -> set[str] | None:
    """Results that it must have been made from, shading packs left out; None if not known."""
    path = Path(artefact.path)
    # What the manifest was made from is followed clip by clip.
    if artefact.path in (SAMPLED_MANIFEST, VERIFICATION) or artefact.stage == "calibrate":
        return None
    filmed = _filmed(_simulation_of(artefact, grid).id, path, config)
    return {
        "simulate": {f"results/calibrate/{CALIBRATION}"},
        "render": filmed,
        "render.packing": filmed,
        "sample": {
            f"results/render/{name}_{view}.parquet"
            for name, view in films(config)
            if name == path.stem
        },
    }[artefact.stage]


def _filmed(simulation: str, path: Path, config: Config) -> set[str]:
    """The trajectories that a shard or its shading shows: its simulation's, or those between."""
    shown = interpolations(config).get((simulation, path.stem.rpartition("_")[2]))
    names = shown.weights if shown else [simulation]
    return {f"results/simulate/{name}.parquet" for name in names}


def _counts(found: Any, total: int) -> bool:
    """Whether these are numbers of frames, of so many in all."""
    numbers = list(found.values()) if isinstance(found, dict) else []
    return all(isinstance(one, int) and one >= 0 for one in numbers) and sum(numbers) == total


def _differing(found: Mapping[str, Any], expected: Mapping[str, Any]) -> Iterator[str]:
    """Keys that are not there, are too many, or hold something else."""
    for key in sorted({*found, *expected}):
        if key not in found:
            yield f"does not state its {key}"
        elif key not in expected:
            yield f"contains a {key}, which is not part of such a record"
        elif not _alike(found[key], expected[key]):
            yield f"its {key} does not match configuration and seed"


def _alike(one: Any, other: Any) -> bool:
    """Whether two plain structures are equal, numbers but for rounding."""
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(_alike(one[key], other[key]) for key in one)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(_alike, one, other))
    if isinstance(one, bool) or isinstance(other, bool):
        return one is other
    if isinstance(one, int | float) and isinstance(other, int | float):
        return abs(one - other) <= _NEAR * max(1.0, abs(other))
    return bool(one == other)


def _plain(value: Any) -> Any:
    return json.loads(json.dumps(value))


def _simulated(
    artefact: Artefact, contents: Contents, config: Config, grid: Mapping[str, Simulation]
) -> Iterator[str]:
    """A trajectory's metadata."""
    from slipstitch.simulate.convergence import measured_convergence
    from slipstitch.simulate.drop_and_drag import draw_perturbation

    simulation = _simulation_of(artefact, grid)
    settings = calibrated_simulation(artefact, config, contents.calibrated)
    across_m = np.linspace(0, SIDE_M, settings.vertices_per_side)
    inner_m = TAB_M + 1e-9 if settings.pins == "tabs" else 1e-9
    held = np.flatnonzero((across_m <= inner_m) | (across_m >= SIDE_M - inner_m))
    metadata = dict(artefact.metadata)
    expected = {
        **{name: getattr(simulation, name) for name in ("material", "friction", "seed")},
        **{f"{name}_id": getattr(simulation, f"{name}_id") for name in _IDS},
        "simulation": simulation.id,
        "settings": settings.model_dump(mode="json"),
        "perturbation": _plain(vars(draw_perturbation(settings, simulation.seed))),
        "stage_path": dict(settings.stage),
        "step_s": settings.step_used_s,
        "pinned": held.tolist(),
        "convergence": measured_convergence(simulation.material, simulation.friction, settings),
    }
    if settings.model is None:
        expected["extended_model"] = None
    else:
        metadata.pop("extended_model", None)
    solver = metadata.pop("solver", {})
    device, at_once = metadata.pop("device", None), metadata.pop("simulated_at_once", 0)
    if not isinstance(device, str) or not 1 <= at_once <= len(grid):
        yield "does not state its device and batch size"
    yield from _differing(metadata, expected)
    parts = settings.settle_steps, settings.recorded_steps
    least = sum(ceil(steps / settings.steps_at_once) for steps in parts)
    yield from _possible(solver, settings, least)


_IDS = ("material", "friction", "replicate")


def _possible(solver: Mapping[str, Any], settings: SimulationSettings, steps: int) -> Iterator[str]:
    """Whether the solver's counts can be those of such a simulation."""
    taken, residual = solver["steps"], solver["largest_residual"]
    tolerance = settings.friction_tolerance
    if taken < steps:
        yield f"took {taken} steps; at least {steps} are required up to its last frame"
    if solver["newton_iterations"] < taken:
        yield f"took {solver['newton_iterations']} Newton iterations for {taken} steps"
    if not 0 < residual <= tolerance:
        yield f"its largest residual is {residual:g}, the tolerance {tolerance:g}"
    elif taken >= _MANY_STEPS and residual < _LARGEST_RESIDUAL_SHARE * tolerance:
        yield (
            f"its largest residual is {residual:g}: of {taken} steps that end below {tolerance:g}, "
            "one ends closely below"
        )


def _rendered(
    artefact: Artefact, contents: Contents, config: Config, grid: Mapping[str, Simulation]
) -> Iterator[str]:
    """The metadata of a shard of images or of a shading pack."""
    from slipstitch.audit.cameras import Cameras
    from slipstitch.render.augmentation import draw_augmentation
    from slipstitch.render.surroundings import draw_surroundings

    simulation = _simulation_of(artefact, grid)
    view = Path(artefact.path).stem.split("_")[3]
    name = config.render.viewpoint_ids()[view]
    shown = interpolations(config).get((simulation.id, view))
    digests = {
        name: artefact.inputs.get(f"results/simulate/{name}.parquet")
        for name in (shown.weights if shown else [simulation.id])
    }
    cameras = Cameras(contents.folder, config, simulation, view)
    textures = dict(cameras.job.textures)
    drawn = draw_surroundings(config.render, config.seed, simulation.id, view)
    expected = {
        "simulation": simulation.id,
        "viewpoint": {"id": view, "name": name},
        "surroundings": drawn.record(),
        "camera": cameras.record(),
        "trajectory_sha256": digests if shown else digests[simulation.id],
        "interpolation": asdict(shown) if shown else None,
    }
    if artefact.stage == "render":
        settings = config.render.augmentation
        words = {key: (config.seed, simulation.id, textures[key], name) for key in textures}
        expected |= {
            "pose": cameras.pose(),
            "textures": textures,
            "augmentation": {
                key: draw_augmentation(settings, *words[key]).record() for key in textures
            },
        }
    metadata = dict(artefact.metadata)
    share = metadata.pop("smallest_share_of_cloth_in_image", None)
    if not isinstance(share, int | float) or not 0 <= share <= 1:
        yield "does not state the share of the cloth in its images"
    counts = metadata.pop("interpolated_frames", None)
    counted = _counts(counts, config.simulation.frames) if shown else counts is None
    if not counted:
        yield "does not state which of its frames are interpolated"
    yield from _differing(metadata, _plain(expected))
