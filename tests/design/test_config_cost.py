"""What a configuration costs, before it is run."""

import json
from pathlib import Path

import pytest

from slipstitch.config import load_config, resolve_config
from slipstitch.design import cost as module
from slipstitch.design.cost import estimate, estimate_captures, job_memory_mb

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
    line = module.estimate_line(config)
    assert f"{sum(one.jobs for one in estimate(config))} jobs" in line
    assert "CPU" in line and "of disk" in line
    assert module.estimate_table(config).splitlines()[-1] == line
    for name in module.MEMORY_MIB:
        assert job_memory_mb(name) >= 512
        assert module.job_runtime_min(name, config) >= 15


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
