"""The grid of simulations, with its ids and seeds: the meaning of m05_f0300_r00_t02_v01.

The ids and what they mean are kept in ``results/grid.parquet``.
"""

import hashlib
import math
import os
import re
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance.record import provenance_record, start_clock, write_parquet
from slipstitch.config.catalogue import VIEWPOINTS, fabric_names
from slipstitch.config.model import Config
from slipstitch.config.render import RenderSettings
from slipstitch.config.simulation import GridSettings


@dataclass(frozen=True)
class Simulation:
    """One simulation of the grid."""

    id: str
    material_id: str
    friction_id: str
    replicate_id: str
    material: str
    friction: float
    seed: int
    material_role: str = "train"
    friction_role: str = "train"

    @property
    def replicate(self) -> int:
        """Its number."""
        return int(self.replicate_id[1:])


def classes(grid: GridSettings) -> dict[str, list]:
    """Return the networks' classes: fabrics, as in the catalogue, and friction coefficients."""
    return {
        "material": sorted(grid.materials, key=fabric_names().index),
        "friction": list(grid.frictions),
    }


def material_id(name: str) -> str:
    """Position in the catalogue of ten: ids stay the same whichever fabrics a grid holds."""
    return f"m{fabric_names().index(name):02d}"


def friction_id(friction: float) -> str:
    """The coefficient in thousandths, ``0.35`` -> ``f0350``: ids stay the same in any grid."""
    return f"f{round(1000 * friction):04d}"


def simulation_seed(seed: int, bench: str, replicate: int) -> int:
    """Seed of the bench of one simulation (clamps, curl, fabric), in [0, 2^31).

    A hash of what the bench is, not of its place in the grid: the same at every friction
    coefficient, so that nothing but contact tells them apart, unless `GridSettings.own_benches`
    names it.
    """
    return int.from_bytes(digest(seed, bench, replicate)[:4], "big") & 0x7FFFFFFF


def bench_of(simulation: str) -> str:
    """The bench of a simulation by its id, ``m05_f0300_r00`` -> ``m05_r00``.

    Floor, lamp and noise are drawn by the bench, but of cameras of the family ``bench_1`` ...
    """
    return re.sub(r"_f\d+(?=_|$)", "", simulation)


def simulations(config: Config) -> list[Simulation]:
    """The simulations of the grid, material by material, friction by friction.

    Those for testing only, one a pair, come last: every material at the coefficients off the grid,
    then every fabric that no network trains on, at the grid's.
    """
    grid = config.grid
    parts = (
        (grid.materials, "train", grid.frictions, "train", grid.replicates),
        (grid.materials, "train", grid.test_frictions, "test", 1),
        (grid.test_materials, "test", grid.frictions, "train", 1),
    )
    return [
        _simulation(config, material, friction, replicate, material_role, friction_role)
        for materials, material_role, frictions, friction_role, replicates in parts
        for material in materials
        for friction in frictions
        for replicate in range(replicates)
    ]


def _simulation(
    config: Config, material: str, friction: float, replicate: int, *roles: str
) -> Simulation:
    ids = material_id(material), friction_id(friction), f"r{replicate:02d}"
    is_own = config.grid.own_benches and replicate >= config.simulation.ideal_replicates
    bench = f"{material} {ids[1]}" if is_own else material
    seed = simulation_seed(config.seed, bench, replicate)
    return Simulation("_".join(ids), *ids, material, friction, seed, *roles)


def find_simulation(config: Config, name: str) -> Simulation:
    """The simulation with id `name`; BadInput if the grid does not have it."""
    grid = simulations(config)
    for simulation in grid:
        if simulation.id == name:
            return simulation
    raise BadInput(
        f"the grid has no simulation {name!r}; its {len(grid)} ids look like {grid[0].id}"
    )


def texture_ids(render: RenderSettings) -> dict[str, str]:
    """Ids t00, t01, ... -> names, training textures first."""
    return {f"t{i:02d}": name for i, name in enumerate(render.textures + render.test_textures)}


def viewpoint_ids(render: RenderSettings) -> dict[str, str]:
    """Ids v00, v01, ... -> names: training, testing, then training on reflective floors."""
    names = render.viewpoints + render.test_viewpoints
    names += render.viewpoints if render.reflective_floors else []
    return {f"v{i:02d}": name for i, name in enumerate(names)}


def is_reflective(render: RenderSettings, viewpoint_id: str) -> bool:
    """Whether a viewpoint is one of the second training set's, on its floors."""
    apart = len(render.viewpoints) + len(render.test_viewpoints)
    return viewpoint_id in list(viewpoint_ids(render))[apart:]


def floors_of(render: RenderSettings, viewpoint_id: str) -> list[str]:
    """The floors that may lie under the cloth as seen from a viewpoint, by its id."""
    return render.reflective_floors if is_reflective(render, viewpoint_id) else render.floors


def textures(config: Config) -> list[dict[str, str]]:
    """Textures as ``{id, name, role}``: those of training (role train), then of testing (test)."""
    trained = config.render.textures
    return [
        {"id": identity, "name": name, "role": "train" if name in trained else "test"}
        for identity, name in texture_ids(config.render).items()
    ]


def viewpoints(config: Config) -> list[dict[str, str]]:
    """Viewpoints as ``{id, name, role, floor_role}``: of training, then of testing.

    Where there are reflective floors, those of training come once more, the floor for testing.
    """
    render = config.render
    return [
        {
            "id": identity,
            "name": name,
            "role": "test" if name in render.test_viewpoints else "train",
            "floor_role": "test" if is_reflective(render, identity) else "train",
        }
        for identity, name in viewpoint_ids(render).items()
    ]


def films(config: Config) -> dict[tuple[str, str], dict[str, str]]:
    """Ids of simulation and viewpoint -> the textures filmed, id -> name; none if there is no film.

    Where videos of test viewpoints are drawn, by what they are, so that one more texture changes
    few, test textures are filmed from the main training viewpoints only.
    """
    render = config.render
    names = texture_ids(render)
    trained = {identity: names[identity] for identity in list(names)[: len(render.textures)]}
    grid = simulations(config)
    result: dict[tuple[str, str], dict[str, str]] = {}
    for view in viewpoints(config):
        if view["role"] == "test" and render.test_viewpoint_videos is not None:
            trains = [s.id for s in grid if "test" not in (s.material_role, s.friction_role)]
            every = [(simulation, texture) for simulation in trains for texture in trained]
            every.sort(key=lambda one: digest(config.seed, view["name"], one[0], names[one[1]]))
            for simulation, texture in sorted(every[: render.test_viewpoint_videos]):
                result.setdefault((simulation, view["id"]), {})[texture] = names[texture]
        else:
            textures = trained if view["floor_role"] == "test" else names
            result |= {(simulation.id, view["id"]): textures for simulation in grid}
    return result


def digest(*words: object) -> bytes:
    """SHA-256 of words, by which what depends on them alone is drawn."""
    return hashlib.sha256("|".join(map(str, words)).encode()).digest()


def grid_rows(config: Config) -> list[dict]:
    """Rows of ``grid.parquet``: kind, id, name, value (coefficient, azimuth, number), roles."""
    rows: list[dict[str, Any]] = [
        {"kind": "material", "id": material_id(name), "name": name}
        for name in config.grid.materials
    ]
    rows += [
        {"kind": "friction", "id": friction_id(f), "name": f"{f:g}", "value": f}
        for f in config.grid.frictions
    ]
    rows += [
        {"kind": "replicate", "id": f"r{i:02d}", "name": f"replicate {i}", "value": float(i)}
        for i in range(config.grid.replicates)
    ]
    rows += [{"kind": "texture", **texture} for texture in textures(config)]
    rows += [
        {"kind": "viewpoint", **view, "value": VIEWPOINTS[view["name"]].azimuth_deg}
        for view in viewpoints(config)
    ]
    rows += [
        {"kind": "simulation", "name": one.id, "value": one.friction, **asdict(one)}
        for one in simulations(config)
    ]
    return [{"role": "train", "floor_role": "train", "value": math.nan, **row} for row in rows]


def write_grid(config: Config, path: str | os.PathLike) -> None:
    """Write `grid_rows` as ``grid.parquet``."""
    import pyarrow as pa

    started = start_clock()
    text = ["kind", "id", "name", "role", "floor_role"]
    text += ["material_id", "friction_id", "replicate_id", "material"]
    schema = pa.schema(
        [(name, pa.string()) for name in text]
        + [("value", pa.float64()), ("friction", pa.float64()), ("seed", pa.int64())]
    )
    keys = config.model_dump(mode="json", include={"seed", "grid", "render"})
    record = provenance_record("grid", config=keys, seed=config.seed, started=started)
    write_parquet(pa.Table.from_pylist(grid_rows(config), schema=schema), path, record=record)


def sampled_frames(frames_total: int, frames_sampled: int) -> np.ndarray:
    """Numbers (int64) of frames at regular intervals from 0 on: ``floor(k total / sampled)``."""
    if not 1 <= frames_sampled <= frames_total:
        raise BadInput(
            f"{frames_sampled} frames cannot be sampled of {frames_total}: "
            "must be at least 1 and at most the number of frames"
        )
    return np.arange(frames_sampled, dtype=np.int64) * frames_total // frames_sampled
