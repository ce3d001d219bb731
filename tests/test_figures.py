"""Every result in README and docs is the published one, or says how it was measured."""

import importlib
import json
import sys
from pathlib import Path

import numpy as np
import pandas
import pytest

from slipstitch.learning.instrument.measuring import stretched

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def figures():
    sys.path.insert(0, str(ROOT / "benchmarks"))
    try:
        return importlib.import_module("figures")
    finally:
        sys.path.remove(str(ROOT / "benchmarks"))


def test_every_figure_is_the_published_one(figures):
    found = figures.complaints()
    assert not found, "\n".join(found)


def _page(figures, tmp_path, text, **published):
    for name, content in published.items():
        path = tmp_path / "results" / "published" / f"{name}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(content))
    (tmp_path / "Makefile").write_text("benchmark:\n")
    return figures.written_again(text, "docs/page.md", tmp_path)


SCORE = (
    "# Page\n\nIt was fast. It is right in {}<!-- results/published/scores.json: {} --> % of all.\n"
)
SCORES = {"by_video": {"friction_lt_0.1": 0.876, "errors_m": [-0.002, 0.001, 0.004]}}


@pytest.mark.parametrize(
    ("steps", "figure"),
    [
        ("/by_video/friction_lt_0.1 | .1%", "87.6"),
        ("/by_video/errors_m/* | median | * 1e3 | .1f", "1.0"),
        ("/by_video/errors_m/0 | * 1e3 | .0f", "−2"),
        ("/by_video/errors_m | len | d", "3"),
    ],
)
def test_a_figure_is_written_from_its_file(figures, tmp_path, steps, figure):
    text, found = _page(figures, tmp_path, SCORE.format("99", steps), scores=SCORES)
    assert text == SCORE.format(figure, steps)
    assert (
        len(found) == 1
    )  # the drift names the place, the sentence and the figure that it should be
    assert found[0].startswith("docs/page.md:3: 'It is right in 99 % of all.'")
    assert f"has {figure} (make figures)" in found[0]
    assert _page(figures, tmp_path, text)[1] == []


def test_the_interval_of_a_share_comes_from_the_predictions(figures, tmp_path):
    """All of four simulations right: Clopper and Pearson's lower bound is 0.05^(1/4)."""
    rows = {"simulation": list("abcd"), "split": "by_video", "network": "n", "seed": 0,
            "true_value": 0.3, "predicted_value": 0.3}  # fmt: skip
    path = tmp_path / "results" / "published" / "run" / "predictions.parquet"
    path.parent.mkdir(parents=True)
    pandas.DataFrame(rows).to_parquet(path)
    source = "results/published/run/predictions.parquet: /by_video/n/{} | .1%"
    text = (
        f"# Page\n\nFrom 0<!-- {source.format('low')} --> to 0<!-- {source.format('high')} -->.\n"
    )
    new, _ = _page(figures, tmp_path, text)
    assert f"From {100 * 0.05**0.25:.1f}<!--" in new and "to 100.0<!--" in new


def test_an_interval_of_few_videos_is_wilsons(figures):
    z, share, number = 1.6448536, 0.25, 20
    centre = (share * number + z**2 / 2) / (number + z**2)
    half = z / (number + z**2) * (number * share * (1 - share) + z**2 / 4) ** 0.5
    shown = f"({100 * (centre - half):.0f} ... {100 * (centre + half):.0f})"
    tables = importlib.import_module("figure_tables")
    assert tables.wilson(share, number) == shown == "(13 ... 43)"
    row = next(line for line in tables.paper_unseen(ROOT).splitlines() if "by -15°" in line)
    assert f"25.0 {shown}" in row
    three_views = next(
        line for line in tables.paper_unseen(ROOT).splitlines() if "all three" in line
    )
    assert "..." not in three_views  # of one motion each, so not independent


def test_published_readings_are_stretched_as_the_instrument_would(monkeypatch):
    """Medians stay, halves get longer; scores that are not of intervals stay to the last digit."""
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    again = importlib.import_module("stretched_again")
    grid = np.linspace(0, 1.5, 151)
    shares = np.exp(-0.5 * ((grid - np.array([[0.04], [0.7], [1.46]])) / 0.03) ** 2)
    shares /= shares.sum(1, keepdims=True)
    first, second = (stretched(shares, grid, 0.9, factor) for factor in (1.1, 1.9))
    for before, after in zip(first, second, strict=True):
        row = dict(zip(("reading", "low", "high"), before, strict=True))
        found = again.stretched(row, 1.9 / 1.1, 1.5)
        assert [found[name] for name in row] == pytest.approx(list(after))
    old = {
        "all": {"videos": 3, "coverage_90": 0.5},
        "trainings": {"coverage_90": 0.6},
        "readings": [],
    }
    new = {"all": {"videos": 3.01, "coverage_90": 0.9}, "trainings": {"coverage_90": 0.7}}
    assert again.renewed(old, new) == {
        "all": {"videos": 3, "coverage_90": 0.9},
        "trainings": {"coverage_90": 0.6},
    }


@pytest.mark.parametrize(
    "source",
    [
        "lost.json: /by_video",
        "scores.json: /by_video/unknown | .1%",
        "scores.json: /by_video | .1f",
    ],
)
def test_a_missing_source_is_named(figures, tmp_path, source):
    text = SCORE.replace("scores.json: {}", source).format("99")
    new, found = _page(figures, tmp_path, text, scores=SCORES)
    assert new == text
    assert len(found) == 1
    assert found[0].startswith("docs/page.md:3: 'It is right in 99 % of all.': no such figure in")


@pytest.mark.parametrize(
    "result",
    [
        "Right in 99 % of all.",
        "An error of 0.2 ± 0.1.",
        "It took\n9.5 s.",
        "3 of 4 were found.",
        "| a | b |\n|---|---|\n| x | **0.31** |",
        "150 CPU s and 2 GiB.",
    ],
)
def test_a_result_needs_a_source(figures, tmp_path, result):
    page = f"# Page\n\n{result}\n"
    found = _page(figures, tmp_path, page)[1]
    assert found
    assert all("a result without a source" in line for line in found)
    for source in ("Measured once: `make benchmark`.", "<!-- no results: closed forms -->"):
        assert _page(figures, tmp_path, f"{page}\n{source}\n")[1] == []
        assert _page(figures, tmp_path, f"{source}\n\n{page}")[1]  # it holds for its section alone


@pytest.mark.parametrize(
    "command",
    ["make unknown", "slipstitch unknown", "python benchmarks/unknown.py", "pytest tests/no"],
)
def test_a_command_that_is_gone_is_named(figures, tmp_path, command):
    found = _page(
        figures, tmp_path, f"# Page\n\nMeasured once: `make benchmark` and `{command}`.\n"
    )
    assert len(found[1]) == 1
    assert f"there is no {command if 'py' not in command else command.split()[1]}" in found[1][0]


@pytest.mark.parametrize(
    ("command", "lacking"),
    [
        ("python benchmarks/film_speed.py --camera c.json --model m --friction 1", "video of film"),
        ("python benchmarks/film_speed.py x.mp4 --camera c.json --model m", "--friction of film"),
        ("python benchmarks/learning.py --pixel 64", "--pixel of learning.py"),
        ("slipstitch simulate --set time_step_s=0.01", "required: --out"),
        ("slipstitch doctor --estimates config.yaml", "unrecognized arguments: --estimates"),
    ],
)
def test_a_command_that_would_be_refused_is_named(figures, command, lacking):
    (found,) = figures.missing(f"`{command}`", ROOT)
    assert lacking in found
