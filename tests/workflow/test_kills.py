"""kill -9 at random moments, then the same command again: the bits of an undisturbed run."""

import contextlib
import random
import subprocess

import pytest
from support import equal_results, kills

pytestmark = pytest.mark.slow


def test_five_kills_on_the_way_and_the_result_is_the_same(undisturbed, reference):
    """Everything is killed at a random moment, five times in one run of the chain."""
    chance = random.Random(5)
    kills.remove(undisturbed, "simulate_one", "render_shading", "sample_all", "train_one")
    words = undisturbed.snakemake_words("--quiet", "all", "--", "all")
    for _ in range(5):
        process = kills.start(undisturbed, words)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(timeout=chance.uniform(2.0, 25.0))
        kills.kill(process, "machine")
        process.wait()
        assert kills.differences(undisturbed.folder, reference, partial=True) == []
        assert undisturbed.snakemake("--unlock").returncode == 0
    assert undisturbed.snakemake("all").returncode == 0
    assert kills.differences(undisturbed.folder, reference, partial=False) == []
    assert equal_results.leftovers(undisturbed.folder / "results") == []


@pytest.mark.parametrize("rule", ["simulate_one", "render_shading", "train_one"])
@pytest.mark.parametrize("victim", ["worker", "snakemake"])
def test_whoever_is_killed_the_same_command_goes_on(undisturbed, pristine, reference, rule, victim):
    job = next(one for one in kills.jobs(pristine) if one["rule"] == rule)
    done = kills.kill_and_resume(undisturbed, pristine, reference, job, victim, random.Random(rule))
    assert done.problems == []
