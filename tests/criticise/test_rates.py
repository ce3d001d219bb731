"""The benchmark's cases, a handful of them at seeds that nothing was tuned on."""

import importlib.util
from pathlib import Path

import pytest

PLACE = Path(__file__).parents[2] / "benchmarks" / "criticise.py"


@pytest.fixture(scope="module")
def benchmark():
    spec = importlib.util.spec_from_file_location("criticise_benchmark", PLACE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_unseen_cases_are_judged_as_the_published_rates_say(benchmark, hidden_seed):
    first = 40 * hidden_seed(30_000, limit=10**6)
    records = [benchmark.judged(seed) for seed in range(first, first + 40, 2)]
    answers = [(r["truth"]["seed"], r["truth"]["effects"], r["said"]) for r in records]
    assert not any(r["error"] for r in records), answers
    nulls = [r for r in records if benchmark.of("null")(r)]
    # At the published rates each of these fails in fewer than one run of fifty.
    assert sum(benchmark.ALARM(r) for r in nulls) <= 1, answers
    effects = [r for r in records if benchmark.of("single", "pair", "ambiguous", "outside")(r)]
    assert sum(benchmark.wrong_cause(r) for r in effects) <= 2, answers
    strong = [r for r in records if benchmark.separable(r)]
    assert sum(benchmark.exact(r) for r in strong) >= 0.5 * len(strong), answers


def test_wilsons_interval_is_the_textbooks(benchmark):
    # Newcombe 1998, table I: 15 of 148.
    assert benchmark.wilson(15, 148) == "0.10 [0.06, 0.16] 15/148"
    assert benchmark.wilson(0, 0) == "-"
