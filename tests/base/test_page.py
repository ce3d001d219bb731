"""What all pages share: numbers in words, figures with equal bytes, escaped templates."""

import re

import pytest

from slipstitch.base.page import palette
from slipstitch.base.page.figures import new_figure, plain_text, styled, svg, svg_element, svg_uri
from slipstitch.base.page.templates import render
from slipstitch.base.page.wording import (
    breaking,
    duration,
    evenly,
    percent,
    size,
    span,
    with_interval,
)
from slipstitch.learning.evaluation.metrics import METRICS


def test_numbers_read_well_and_a_narrow_column_breaks_before_the_spread_only():
    assert [size(value) for value in (0, 2.5e3, 3.456e6, 7e9, 1.5e12)] == [
        "0 kB", "2.5 kB", "3.46 MB", "7 GB", "1.5 TB",
    ]  # fmt: skip
    times = [duration(value) for value in (3.21, 600, 7300, float("nan"))]
    assert times == ["3.2 s", "10.0 min", "2.0 h", "–"]
    assert with_interval(0.844, (0.439, 1.231)) == "0.84 [0.44, 1.23]"
    assert with_interval(0.123, (0.04, 0.21), 0, 100.0, " %") == "12 % [4, 21]"
    assert span((0.1, 0.14), 2) == "0.10 … 0.14"
    spread = "±\N{NO-BREAK SPACE}2.0\N{NO-BREAK SPACE}%"
    assert breaking(percent(0.5, 0.02)).split(" ") == ["50.0", spread]


@styled
def drawn():
    figure = new_figure(2, 1)
    figure.subplots().plot([0, 1], [0, 1], color=palette.BLUE)
    return figure


def test_equal_figures_have_equal_bytes():
    assert svg(drawn()) == svg(drawn())
    element = svg_element(drawn(), "Two & more")
    assert element.startswith('<svg role="img" aria-label="Two &amp; more"')
    assert "<metadata>" not in element and element == svg_element(drawn(), "Two & more")
    assert svg_uri(None) is None and svg_uri(drawn()) == svg_uri(svg(drawn()))


@pytest.mark.parametrize("words", ["price $5_$6_.mp4", r"\$5_$6_", "a$b", "$a$"])
def test_words_from_outside_are_drawn_as_they_are(words):
    figure = new_figure(2, 1)
    figure.suptitle(plain_text(words))
    assert f"<!-- {words} -->" in svg(figure)


@pytest.mark.parametrize(("name", "escaped"), [("own.html.j2", True), ("own.md.j2", False)])
def test_html_is_escaped_and_markdown_is_not(tmp_path, name, escaped):
    (tmp_path / name).write_text("{{ words }}")
    assert render(tmp_path / name, words="a < b") == ("a &lt; b" if escaped else "a < b")


def test_a_page_of_the_base_has_the_palettes_colours(tmp_path):
    text = '{% extends "base.html.j2" %}{% block title %}T{% endblock %}'
    (tmp_path / "own.html.j2").write_text(text)
    page = render(tmp_path / "own.html.j2")
    assert f"--ink: {palette.INK};" in page
    patterns = (r"var\(--([a-z-]+)\)", r"--([a-z-]+):")
    used, stated = (set(re.findall(pattern, page)) for pattern in patterns)
    assert used <= stated and f"--good: {palette.GOOD};" in page


def test_every_metric_is_listed_once():
    assert len({metric.name for metric in METRICS}) == len(METRICS)
    assert {metric.unit for metric in METRICS} == {"%", "µ"}


def test_a_legend_names_few_entries_of_an_ordered_scale_and_both_ends():
    assert evenly([0.1, 0.3]) == [0.1, 0.3]
    assert evenly([f"{k / 10:g}" for k in range(16)]) == ["0", "0.3", "0.6", "0.9", "1.2", "1.5"]
