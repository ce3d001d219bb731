"""Ids and seeds of the grid, and what a configuration costs, before it is run."""

import json
import math
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import read_provenance
from slipstitch.config import load_config, resolve_config
from slipstitch.design import cost as costs
from slipstitch.design import grid as module
from slipstitch.design.cost import estimate, estimate_captures, job_memory_mb
from slipstitch.design.grid import bench_of, films, find_simulation, simulations, viewpoints


def grid(**keys):
    return resolve_config({"grid": keys})


def test_ids_say_the_place_in_the_catalogue_and_the_value_in_thousandths():
    config = grid(materials=["gray-interlock", "ivory-rib-knit"], frictions=[0.1, 0.4])
    assert [one.id for one in simulations(config)] == [
        "m05_f0100_r00", "m05_f0100_r01", "m05_f0400_r00", "m05_f0400_r01",
        "m00_f0100_r00", "m00_f0100_r01", "m00_f0400_r00", "m00_f0400_r01",
    ]  # fmt: skip
    one = find_simulation(config, "m00_f0400_r01")
    assert (one.material, one.friction, one.replicate_id) == ("ivory-rib-knit", 0.4, "r01")
    with pytest.raises(BadInput, match="no simulation 'm09_f0100_r00'"):
        find_simulation(config, "m09_f0100_r00")


def test_a_simulation_is_the_same_in_any_grid():
    before, after = (
        {one.id: one for one in simulations(grid(frictions=frictions))}
        for frictions in ([0.1, 0.5], [0.1, 0.345, 0.5, 10.0])
    )
    assert {name: after[name] for name in before} == before
    assert {one.friction_id for one in after.values()} == {"f0100", "f0345", "f0500", "f10000"}
    alone = simulations(grid(frictions=[0.5], replicates=1, materials=["gray-interlock"]))
    assert alone == [before["m05_f0500_r00"]]


def test_every_fabric_and_replicate_has_a_seed_of_its_own_whatever_the_coefficient():
    """Common random numbers: the bench says nothing of the coefficient."""
    drawn = simulations(grid(replicates=20))
    benches = {(one.material, one.replicate_id, one.seed) for one in drawn}
    seeds = {seed for *_, seed in benches}
    assert len(benches) == len(seeds) == len({bench_of(one.id) for one in drawn}) == 3 * 20
    assert all(0 <= seed < 2**31 for seed in seeds)
    assert bench_of("m05_f0300_r00") == bench_of("m05_f1300_r00") == "m05_r00"
    others = simulations(resolve_config({"seed": 2, "grid": {"replicates": 20}}))
    assert not {one.seed for one in others} & seeds


PAPER = {
    "grid": {"replicates": 1},
    "render": {
        "textures": ["dots", "stripes"],
        "test_textures": ["chevron"],
        "viewpoints": ["calibrated", "side"],
        "test_viewpoints": ["calibrated_-5", "calibrated_+5"],
        "test_viewpoint_videos": 5,
        "reflective_floors": ["ceramic", "aluminium"],
    },
}


def test_training_comes_before_testing_and_once_more_on_other_floors_at_the_end():
    config = resolve_config(PAPER)
    assert [tuple(one.values()) for one in module.textures(config)] == [
        ("t00", "dots", "train"),
        ("t01", "stripes", "train"),
        ("t02", "chevron", "test"),
    ]
    assert [tuple(one.values()) for one in viewpoints(config)] == [
        ("v00", "calibrated", "train", "train"),
        ("v01", "side", "train", "train"),
        ("v02", "calibrated_-5", "test", "train"),
        ("v03", "calibrated_+5", "test", "train"),
        ("v04", "calibrated", "train", "test"),
        ("v05", "side", "train", "test"),
    ]
    assert module.floors_of(config.render, "v01") == ["matte"]
    assert module.floors_of(config.render, "v05") == ["ceramic", "aluminium"]
    shown = films(config)
    for simulation in simulations(config):
        assert list(shown[simulation.id, "v00"]) == ["t00", "t01", "t02"]
        assert list(shown[simulation.id, "v05"]) == ["t00", "t01"]


def test_as_many_videos_as_asked_for_are_drawn_from_a_test_viewpoint():
    """By what they are: other fabrics and viewpoints leave those of a viewpoint alone."""
    drawn = turned(resolve_config(PAPER))
    assert [len(drawn[view]) for view in ("calibrated_-5", "calibrated_+5")] == [5, 5]
    assert drawn["calibrated_-5"] != drawn["calibrated_+5"]
    assert {texture for videos in drawn.values() for _, texture in videos} == {"dots", "stripes"}
    alone = turned(resolve_config({**PAPER, "render": PAPER["render"] | {"viewpoints": ["side"]}}))
    assert alone["calibrated_+5"] == drawn["calibrated_+5"]
    more = PAPER["render"] | {"textures": ["linen", "dots", "stripes"]}
    kept = turned(resolve_config({**PAPER, "render": more}))["calibrated_+5"]
    assert {video for video in kept if video[1] != "linen"} <= drawn["calibrated_+5"]
    every = turned(resolve_config({**PAPER, "render": more | {"test_viewpoint_videos": 1000}}))
    assert len(every["calibrated_+5"]) == 3 * 4 * 3


def turned(config):
    """Test viewpoint -> simulations and textures that are filmed from it."""
    names = {one["id"]: one["name"] for one in viewpoints(config) if one["role"] == "test"}
    found = {name: set() for name in names.values()}
    for (simulation, view), textures_shown in films(config).items():
        if view in names:
            found[names[view]] |= {(simulation, name) for name in textures_shown.values()}
    return found


def test_rows_explain_every_part_of_every_id_and_are_read_back_with_their_provenance(tmp_path):
    path = tmp_path / "grid.parquet"
    config = grid(materials=["gray-interlock"], frictions=[0.1, 0.4], replicates=2)
    module.write_grid(config, path)
    rows = pq.read_table(path).to_pylist()
    by_id = {row["id"]: row for row in rows}
    assert len(by_id) == len(rows)
    for one in simulations(config):
        assert by_id[one.material_id]["name"] == one.material
        assert by_id[one.friction_id]["value"] == by_id[one.id]["friction"] == one.friction
        assert by_id[one.replicate_id]["kind"] == "replicate"
        assert (by_id[one.id]["kind"], by_id[one.id]["seed"]) == ("simulation", one.seed)
    assert math.isnan(by_id["m05"]["value"])
    assert read_provenance(path)["config"]["grid"]["frictions"] == [0.1, 0.4]


BENCHES = {"render": {"viewpoints": ["bench_1"]}, "train": {"splits": ["by_simulation"]}}


def test_benches_are_shared_by_the_coefficients_unless_each_has_its_own():
    grid = {"materials": ["royal-target"], "frictions": [0.1, 0.2], "replicates": 2}
    shared = simulations(resolve_config({"grid": grid} | BENCHES))
    own = simulations(resolve_config({"grid": grid | {"own_benches": True}} | BENCHES))
    assert [one.id for one in own] == [one.id for one in shared]
    assert len({one.seed for one in shared}) == 2
    assert len({one.seed for one in own}) == 4
    longer = grid | {"own_benches": True, "frictions": [0.1, 0.15, 0.2]}
    more = {one.id: one.seed for one in simulations(resolve_config({"grid": longer} | BENCHES))}
    assert all(more[one.id] == one.seed for one in own)
    first_ideal = {"grid": grid | {"own_benches": True}, "simulation": {"ideal_replicates": 1}}
    ideal = simulations(resolve_config(first_ideal | BENCHES))
    assert [one.seed for one in ideal[::2]] == [one.seed for one in shared[::2]]
    assert [one.seed for one in ideal[1::2]] == [one.seed for one in own[1::2]]
    with pytest.raises(BadInput, match=r"grid\.own_benches: a bench of one coefficient tells it"):
        resolve_config({"grid": {"own_benches": True}})


ONE = {"grid": {"replicates": 1}, "render": {"pixels": 64}, "train": {"width": 0.25}}


def stage(config, name):
    return next(one for one in estimate(config) if one.stage == name)


#: What changes -> of which stage, what grows, how many times.
GROWTH = [
    ({"grid": {"replicates": 2}}, "simulate", {"cpu_s": 2, "disk_bytes": 2, "jobs": 2}),
    ({"simulation": {"frames": 600}}, "simulate", {"cpu_s": 2, "disk_bytes": 2, "jobs": 1}),
    ({"render": {"pixels": 128}}, "sample", {"disk_bytes": 4}),
    ({"render": {"pixels": 128}}, "render", {"jobs": 1}),
    ({"train": {"width": 1.0}}, "train", {"cpu_s": 16}),
]


@pytest.mark.parametrize(("sections", "name", "factors"), GROWTH)
def test_costs_are_in_proportion_to_what_is_made(sections, name, factors):
    base, more = (stage(resolve_config(ONE, one), name) for one in ({}, sections))
    for what, factor in factors.items():
        assert getattr(more, what) == pytest.approx(factor * getattr(base, what))


def test_larger_images_and_all_frames_cost_more_to_render():
    base, *more = (
        stage(resolve_config({"render": one}), "render").cpu_s
        for one in ({}, {"pixels": 128}, {"frames": "all"})
    )
    assert min(more) > base


def test_the_line_gives_jobs_time_and_disk_and_every_stage_has_limits_for_a_scheduler():
    config = resolve_config({})
    line = costs.estimate_line(config)
    assert f"{sum(one.jobs for one in estimate(config))} jobs" in line
    assert "CPU" in line and "of disk" in line
    assert costs.estimate_table(config).splitlines()[-1] == line
    for name in costs.MEMORY_MIB:
        assert job_memory_mb(name) >= 512
        assert costs.job_runtime_min(name, config) >= 15


def test_training_asks_for_memory_for_the_videos_that_it_holds():
    small, large = (resolve_config({"grid": {"replicates": count}}) for count in (1, 50))
    videos = 49 * 3 * 4 * 3 * 3  # replicates, fabrics, coefficients, textures, views
    video_bytes = 30 * 64 * 64 * 3
    more = job_memory_mb("train", large) - job_memory_mb("train", small)
    # While their colours are counted: themselves, a copy, and eight bytes a pixel and colour.
    assert 4.2 < more * 1e6 / (videos * video_bytes) < 5.5
    assert job_memory_mb("simulate", large) == job_memory_mb("simulate", small)
    # Of one viewpoint, as rendered whatever the networks see.
    more = job_memory_mb("instrument", large) - job_memory_mb("instrument", small)
    assert 3.0 < more * 1e6 / (videos / 3 * video_bytes) < 4.0
    coarse = resolve_config({"grid": {"replicates": 50}, "train": {"pixels": 32}})
    assert job_memory_mb("instrument", coarse) == job_memory_mb("instrument", large)
    assert job_memory_mb("train", coarse) < job_memory_mb("train", large) / 2


@pytest.mark.parametrize("run", ["paper", "instrument"])
def test_what_is_declared_holds_with_room_what_the_published_runs_took(run):
    folder = Path(__file__).parents[2] / "results" / "published" / run
    config = load_config(folder / "config.json")
    kinds = {"convergence": "simulate", "render/shade": "render", "render/compose": "compose"}
    for cost in json.loads((folder / "cost.json").read_text(encoding="utf-8")):
        kind = kinds.get(cost["stage"], cost["stage"].split("/")[0])
        declared_mib = job_memory_mb(kind, config) * 1e6 / 2**20
        assert 1.3 * cost["memory_mib"] < declared_mib, cost["stage"]


def test_captures_cost_more_with_more_films_and_nothing_with_films_of_ones_own():
    few, many = (
        estimate_captures(resolve_config({"captures": {"repeats": repeats}})) for repeats in (1, 5)
    )
    assert (few.jobs, many.jobs) == (4 + 4, 20 + 4)
    assert many.cpu_s == pytest.approx(5 * few.cpu_s)
    own = estimate_captures(resolve_config({"captures": {"table": "bench/captures.csv"}}))
    assert (own.jobs, own.cpu_s) == (2, 0)
