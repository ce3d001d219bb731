"""What every record says, against what configuration, seeds and the other records give.

Where the code of a stage has not changed, nothing in a record is left to faith but what only the
job itself could measure: times, the machine, how many iterations a solver took. Of these it is
asked whether they are possible.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np

from slipstitch.base.errors import first_line
from slipstitch.config import Config
from slipstitch.config.simulation import SimulationSettings
from slipstitch.dataset.audit.admission import UNUSABLE
from slipstitch.dataset.audit.contents import Contents
from slipstitch.dataset.audit.findings import Finding, Kind
from slipstitch.dataset.audit.lineage import SAMPLED_MANIFEST, Lineage
from slipstitch.dataset.audit.staleness import quoted_study
from slipstitch.dataset.release.code import CODE, locked_versions
from slipstitch.dataset.release.currency import CALIBRATION, calibrated_simulation, other_versions
from slipstitch.dataset.release.records import (
    VERIFICATION,
    Artefact,
    carried_file,
    is_ours,
    record_file,
    recorded_name,
)
from slipstitch.design.grid import Simulation, films, simulations
from slipstitch.design.interpolation import Interpolation, interpolations
from slipstitch.design.stage_path import SIDE_M, TAB_M
from slipstitch.images.keypoints import KEYPOINTS_UV, keypoint_vertices_uv
from slipstitch.physics.friction_law.extended_model import read_extended_model

# Where a stage writes; the first that fits.
STAGES = {
    "results/criticise/": "criticise",
    "results/calibrate/sweep/": "calibrate.sweep",
    "results/calibrate/": "calibrate.calibration",
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
    "criticise": (),
    "calibrate.sweep": ("simulation", "calibrate"),
    "calibrate.calibration": ("simulation", "calibrate"),
    "simulate": ("simulation",),
    "render": ("render",),
    "render.packing": ("render",),
    "sample": ("grid", "render", "sample"),
}
_NEAR = 1e-9
# A step ends when its residual is below the tolerance: of many, one ends closely below.
_LARGEST_RESIDUAL_SHARE = 0.1
_MANY_STEPS = 100
# A cloth hardly stretches (simulated edges by up to 2 %), and lies on the floor at the lowest.
_LARGEST_STRETCH = 1.05
_LOWEST_M = -1e-3


@dataclass(frozen=True)
class _Known:
    """What configuration and seed give: computed once for all records."""

    config: Config
    grid: Mapping[str, Simulation]
    between: Mapping[tuple[str, str], Interpolation]

    @classmethod
    def of(cls, config: Config) -> "_Known":
        grid = {simulation.id: simulation for simulation in simulations(config)}
        return cls(config, grid, interpolations(config))

    def simulation_of(self, artefact: Artefact) -> Simulation:
        """The simulation that it belongs to."""
        name = "_".join(Path(artefact.path).stem.split("_")[:3])
        if name not in self.grid:
            raise ValueError(f"{name} is not in the configured grid")
        return self.grid[name]

    def trajectories(self, artefact: Artefact) -> list[str]:
        """What a shard or its shading shows: its own simulation, or those between which it lies."""
        shown = self.shown(artefact)
        names = shown.weights if shown else [self.simulation_of(artefact).id]
        return [f"results/simulate/{name}.parquet" for name in names]

    def shown(self, artefact: Artefact) -> Interpolation | None:
        """The cloth of a shard or its shading, if it lies between simulations."""
        return self.between.get((self.simulation_of(artefact).id, _view(artefact)))


def _view(artefact: Artefact) -> str:
    return Path(artefact.path).stem.rpartition("_")[2]


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
    known = _Known.of(config)
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
            problems += _made_with(artefact, known)
            if stage not in stale and path != VERIFICATION and stage in checks:
                problems += checks[stage](artefact, contents, known)
        except UNUSABLE as error:
            problems.append(f"cannot be traced: {first_line(error)}")
        for problem in problems:
            yield _broken(lineage, artefact, problem)


def _broken(lineage: Lineage, artefact: Artefact, what: str) -> Finding:
    return Finding(Kind.BROKEN, record_file(artefact.path), what, lineage.clips(artefact.path))


def _made_with(artefact: Artefact, known: _Known) -> Iterator[str]:
    """Whether no key of a section is left out, and the seed."""
    recorded = artefact.record["config"]
    config = known.config
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
        seed = known.simulation_of(artefact).seed
    elif artefact.stage.startswith("calibrate."):
        seed = None
    # A criticism's own is no part of the configuration.
    if artefact.stage != "criticise" and artefact.record.get("seed") != seed:
        yield f"its seed is {artefact.record.get('seed')!r}, the configuration gives {seed!r}"
    made_from = {name for name in artefact.inputs if is_ours(name)}
    needed = _inputs(artefact, known)
    if needed is not None and {name for name in made_from if "/shading/" not in name} != needed:
        odd = min(made_from ^ needed)
        yield f"was made {'from' if odd in made_from else 'without'} {odd}"
    model = config.simulation.model
    if artefact.stage == "simulate" and model and _law(artefact, config) is None:
        yield f"was made without {model}"


def _law(artefact: Artefact, config: Config) -> str | None:
    """What the record of a simulation calls the configured extended model."""
    model = config.simulation.model
    return recorded_name(model, artefact.inputs) if model else None


def _inputs(artefact: Artefact, known: _Known) -> set[str] | None:
    """Results that it must have been made from, shading packs left out; None if not known."""
    path = Path(artefact.path)
    # What the manifest was made from is followed clip by clip.
    if artefact.path in (SAMPLED_MANIFEST, VERIFICATION):
        return None
    if artefact.stage == "criticise" or artefact.stage.startswith("calibrate."):
        return None
    filmed = set(known.trajectories(artefact))
    law = _law(artefact, known.config)
    return {
        "simulate": {f"results/calibrate/{CALIBRATION}", *([law] if law and is_ours(law) else [])},
        "render": filmed,
        "render.packing": filmed,
        "sample": {
            f"results/render/{name}_{view}.parquet"
            for name, view in films(known.config)
            if name == path.stem
        },
    }[artefact.stage]


def _counts(found: Any, total: int) -> bool:
    """Whether these are numbers of frames, of so many in all."""
    numbers = list(found.values()) if isinstance(found, dict) else []
    return all(isinstance(one, int) and one >= 0 for one in numbers) and sum(numbers) == total


def _points_of_a_cloth(found: Any, camera: Mapping[str, Any], vertices_per_side: int) -> bool:
    """Whether these can be the places of a cloth's marked points, in each of a camera's frames."""
    if not isinstance(found, dict) or list(found) != list(camera["frames"]):
        return False
    flat_m = SIDE_M * keypoint_vertices_uv(vertices_per_side)
    longest_m = _LARGEST_STRETCH * np.linalg.norm(flat_m[:, None] - flat_m[None], axis=2)
    places_m = np.array(list(found.values()), dtype=np.float64).reshape(-1, len(KEYPOINTS_UV), 3)
    apart_m = np.linalg.norm(places_m[:, :, None] - places_m[:, None], axis=3)
    return bool((apart_m <= longest_m + _NEAR).all() and (places_m[..., 2] >= _LOWEST_M).all())


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


def _simulated(artefact: Artefact, contents: Contents, known: _Known) -> Iterator[str]:
    """A trajectory's metadata."""
    from slipstitch.physics.simulation.convergence import measured_convergence
    from slipstitch.physics.simulation.drop_and_drag import draw_perturbation

    simulation = known.simulation_of(artefact)
    settings = calibrated_simulation(artefact, known.config, contents.calibrated)
    across_m = np.linspace(0, SIDE_M, settings.vertices_per_side)
    inner_m = TAB_M + 1e-9 if settings.pins == "tabs" else 1e-9
    held = np.flatnonzero((across_m <= inner_m) | (across_m >= SIDE_M - inner_m))
    metadata = dict(artefact.metadata)
    expected = {
        **{name: getattr(simulation, name) for name in ("material", "friction", "seed")},
        **{f"{name}_id": getattr(simulation, f"{name}_id") for name in _IDS},
        "simulation": simulation.id,
        "settings": settings.model_dump(mode="json"),
        "perturbation": _plain(
            vars(draw_perturbation(settings, simulation.seed, simulation.replicate))
        ),
        "stage_path": dict(settings.stage),
        "step_s": settings.step_used_s,
        "pinned": held.tolist(),
    }
    measured = measured_convergence(simulation.material, simulation.friction, settings)
    if quoted_study(artefact) in (None, measured and measured["table_sha256"]):
        expected["convergence"] = measured
    else:
        metadata.pop("convergence")  # of another study: slipstitch.dataset.audit.staleness says so
    law = _law(artefact, known.config)
    expected["extended_model"] = (
        _plain(asdict(read_extended_model(contents.folder / carried_file(law)))) if law else None
    )
    solver = metadata.pop("solver", {})
    if not isinstance(metadata.pop("device", None), str):
        yield "does not state its device"
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


def _rendered(artefact: Artefact, contents: Contents, known: _Known) -> Iterator[str]:
    """The metadata of a shard of images or of a shading pack."""
    from slipstitch.dataset.audit.cameras import Cameras

    config, simulation, view = known.config, known.simulation_of(artefact), _view(artefact)
    name = config.render.viewpoint_ids()[view]
    shown = known.shown(artefact)
    digests = {Path(path).stem: artefact.inputs.get(path) for path in known.trajectories(artefact)}
    cameras = Cameras(contents, config, simulation, view)
    expected = {
        "simulation": simulation.id,
        "viewpoint": {"id": view, "name": name},
        "surroundings": cameras.view.surroundings.record(),
        "camera": cameras.record(),
        "trajectory_sha256": digests if shown else digests[simulation.id],
        "interpolation": asdict(shown) if shown else None,
    }
    if artefact.stage == "render":
        effects = cameras.view.camera_effects()
        expected |= {
            "pose": cameras.pose(),
            "textures": dict(cameras.view.textures),
            "augmentation": {key: drawn.record() for key, drawn in effects.items()},
        }
    metadata = dict(artefact.metadata)
    if artefact.stage == "render":
        points = metadata.pop("marked_points_m", None)
        if not _points_of_a_cloth(points, metadata["camera"], config.simulation.vertices_per_side):
            yield "does not state places that the cloth's points can have"
    share = metadata.pop("smallest_share_of_cloth_in_image", None)
    if not isinstance(share, int | float) or not 0 <= share <= 1:
        yield "does not state the share of the cloth in its images"
    counts = metadata.pop("interpolated_frames", None)
    counted = _counts(counts, config.simulation.frames) if shown else counts is None
    if not counted:
        yield "does not state which of its frames are interpolated"
    yield from _differing(metadata, _plain(expected))
