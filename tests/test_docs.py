"""README and docs: examples run, links lead somewhere, numbers are published, words are counted."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
DOCS = sorted((ROOT / "docs").rglob("*.md"))
PAGES = [README, ROOT / "CHANGELOG.md", *DOCS]


def published(name):
    return json.loads((ROOT / "results/published" / name).read_text(encoding="utf-8"))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_links_lead_to_files_and_headings(page):
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.S)
    for link, _, heading in re.findall(r"\]\(([^)#\s]*)(#([^)]*))?\)", text):
        if link.startswith(("http", "mailto:")):
            continue
        target = page.parent / link if link else page
        assert target.exists(), link
        if heading:
            titles = re.findall(r"^#+ (.*)$", target.read_text(encoding="utf-8"), re.M)
            slugs = [re.sub(r"[^\w\- ]", "", one.lower()).replace(" ", "-") for one in titles]
            assert heading in slugs, f"{link}#{heading}"


def test_the_results_are_written_from_published_files():
    words = [sys.executable, "benchmarks/results_page.py", "--check"]
    answer = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)
    assert answer.returncode == 0, answer.stdout + answer.stderr


def test_the_figures_of_the_readme_are_published():
    networks = published("paper/metrics.json")["by_video"]
    films = {
        name: found["median_within_0.1"]
        for run in ("paper", "paper_reflective")
        for name, found in published(f"{run}/captures/metrics.json")["surrogate_all"].items()
    }
    conditional = "lrcn_conditional_calibrated, trained by_video"
    instrument = published("instrument/details.json")["by_simulation"]["instrument_ensemble"]
    figures = {
        "network": f"{networks['lrcn_conditional']['friction_lt_0.1']:.0%}",
        "probe": f"{networks['probe_middle_frame']['friction_lt_0.1']:.0%}",
        "films, matte training": f"{films[conditional]:.0%}",
        "films, reflective training": f"{films[conditional + '_reflective']:.0%}",
        "known": f"{instrument['mean']['mean_absolute_error']:.3f}",
        "coverage": f"{instrument['mean']['coverage_90']:.0%}",
        "other": f"{published('camera/drawn_fabrics.json')['all']['mean_absolute_error']:.3f}",
    }
    text = README.read_text(encoding="utf-8").replace(" %", "%")
    section = text[text.index("## How well it works") : text.index("## What it cannot do")]
    for name, figure in figures.items():
        assert figure in section, f"{name}: published is {figure}"


def test_readme_and_docs_stay_short():
    assert len(README.read_text(encoding="utf-8").split()) <= 500
    assert len(DOCS) <= 13
    assert sum(len(page.read_text(encoding="utf-8").split()) for page in DOCS) <= 16_000


def test_the_container_is_built_from_what_there_is():
    text = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    copied = re.findall(r"^COPY (\S+) ", text, re.M)
    assert copied == ["envs/system-packages.txt", "envs/requirements.lock", "."]
    assert all((ROOT / source).exists() for source in copied)
    lock = (ROOT / "envs/requirements.lock").read_text(encoding="utf-8")
    assert "\nsetuptools==" in lock  # the build is not isolated


EXAMPLES = re.findall(
    r"^```python\n(.*?)^```$",
    (ROOT / "docs/quickstart.md").read_text(encoding="utf-8"),
    re.M | re.S,
)


def test_the_examples_run_and_are_short(tmp_path):
    assert len(EXAMPLES) == 4
    assert all(len(example.splitlines()) <= 10 for example in EXAMPLES)
    answer = subprocess.run(
        [sys.executable, "-c", "\n".join(EXAMPLES)],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT / "src")},
        capture_output=True,
        text=True,
    )
    assert answer.returncode == 0, answer.stderr
    fallen, acceleration, verdict = answer.stdout.splitlines()
    assert abs(float(re.search(r"vertex (\S+) mm", fallen).group(1))) < 0.1  # on the floor
    measured, theory = map(float, acceleration.split())
    assert abs(measured - theory) < 1e-3 * theory
    assert verdict.startswith("Between the runs nothing beyond plain Coulomb friction")
    assert pq.read_metadata(tmp_path / "drop_v00.parquet").num_rows == 3
