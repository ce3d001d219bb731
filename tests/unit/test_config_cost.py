"""What a configuration costs, before it is run."""

import pytest

from slipstitch.config import resolve_config
from slipstitch.doctor.cost import (
    COSTS,
    JOB_KINDS,
    estimate,
    estimate_captures,
    estimate_line,
    estimate_table,
    job_memory_mb,
    job_runtime_min,
)


def stage(config, name):
    return next(one for one in estimate(config) if one.stage == name)


def test_simulations_cost_in_proportion_to_their_number_and_simulated_time():
    base = resolve_config({"grid": {"replicates": 1}})
    twice = resolve_config({"grid": {"replicates": 2}})
    long = resolve_config({"grid": {"replicates": 1}, "simulation": {"frames": 600}})
    for more in (twice, long):
        assert stage(more, "simulate").cpu_s == pytest.approx(2 * stage(base, "simulate").cpu_s)
        assert stage(more, "simulate").disk_bytes == pytest.approx(
            2 * stage(base, "simulate").disk_bytes
        )
    assert stage(twice, "simulate").jobs == 2 * stage(base, "simulate").jobs


def test_images_cost_in_proportion_to_their_pixels():
    small, large = (resolve_config({"render": {"pixels": pixels}}) for pixels in (64, 128))
    assert stage(large, "sample").disk_bytes == pytest.approx(4 * stage(small, "sample").disk_bytes)
    assert stage(large, "render").cpu_s > stage(small, "render").cpu_s
    assert stage(large, "render").jobs == stage(small, "render").jobs


def test_rendering_every_frame_costs_more_than_the_sampled_ones():
    sampled = resolve_config({"render": {"frames": "sampled"}})
    every = resolve_config({"render": {"frames": "all"}})
    assert stage(every, "render").cpu_s > stage(sampled, "render").cpu_s


def test_wider_networks_train_longer():
    thin, wide = (resolve_config({"train": {"width": width}}) for width in (0.25, 1.0))
    assert stage(wide, "train").cpu_s == pytest.approx(16 * stage(thin, "train").cpu_s)


def test_line_gives_jobs_time_and_disk():
    config = resolve_config({})
    line = estimate_line(config)
    assert f"{sum(one.jobs for one in estimate(config))} jobs" in line
    assert "CPU" in line
    assert "of disk" in line
    assert estimate_table(config).splitlines()[-1] == line


def test_every_stage_has_limits_for_a_scheduler():
    config = resolve_config({})
    for name in JOB_KINDS:
        assert job_memory_mb(name) >= 512
        assert job_runtime_min(name, config) >= 15


def test_training_asks_for_memory_for_the_videos_that_it_holds():
    small, large = (resolve_config({"grid": {"replicates": count}}) for count in (1, 50))
    videos_bytes = 49 * 3 * 4 * 3 * 3 * 30 * 64 * 64 * 3  # fabrics, coefficients, textures, views
    more = job_memory_mb("train", large) - job_memory_mb("train", small)
    assert 1.0 < more * 1e6 / videos_bytes < 1.4
    assert job_memory_mb("simulate", large) == job_memory_mb("simulate", small)


def test_every_cost_says_where_it_comes_from():
    for cost in COSTS.values():
        assert cost.value > 0
        assert cost.unit
        assert cost.source


def test_captures_cost_more_with_more_films_and_nothing_with_films_of_ones_own():
    few, many = (
        estimate_captures(resolve_config({"captures": {"repeats": repeats}})) for repeats in (1, 5)
    )
    assert (few.jobs, many.jobs) == (4 + 4, 20 + 4)
    assert many.cpu_s == pytest.approx(5 * few.cpu_s)
    own = estimate_captures(resolve_config({"captures": {"table": "bench/captures.csv"}}))
    assert (own.jobs, own.cpu_s) == (2, 0)
