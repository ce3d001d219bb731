"""README and docs: links lead somewhere, and the README fits on a screen."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_to_files(page):
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.S)
    links = re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", text)
    missing = [
        link
        for link in links
        if not link.startswith(("http", "mailto:")) and not (page.parent / link).exists()
    ]
    assert missing == []


def test_the_readme_says_what_it_cannot_do_on_one_screen():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 60
    assert text.index("make all") < text.index("## What it cannot do") < text.index("## Further")


def test_the_container_is_built_from_what_there_is():
    text = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    copied = re.findall(r"^COPY (\S+) ", text, re.M)
    assert copied == ["envs/system-packages.txt", "envs/requirements.lock", "."]
    assert all((ROOT / source).exists() for source in copied)
    lock = (ROOT / "envs/requirements.lock").read_text(encoding="utf-8")
    assert "\nsetuptools==" in lock  # the build is not isolated
