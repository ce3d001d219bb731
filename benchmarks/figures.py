"""Figures of README and docs that come from published files: write them again, or check them.

A result stands in the text in one of four ways:

- ``43<!-- results/published/paper/simulations.csv: /cpu_s | median | .0f -->``: a JSON pointer
  (RFC 6901; ``*`` for all members), a column of a CSV file, or ``/SPLIT/NETWORK/low`` or ``high``
  of predictions.parquet, the report's 90 % interval of the share of right answers; then ``min``,
  ``max``, ``mean``, ``median``, ``sum`` or ``len``, a factor such as ``* 1e3``, and a format
  (``.1%`` without the sign);
- in a table between ``<!-- table: NAME -->`` and ``<!-- end -->``, or on a page, that ``TABLES`` or
  ``PAGES`` writes;
- in a section (from heading to heading) with "Measured once: `COMMAND`" or "Estimated: `COMMAND`";
- in none: ``<!-- no results: WHY -->`` in the section (settings, demands, closed forms).
"""

import argparse
import ast
import contextlib
import importlib
import io
import itertools
import json
import re
import shlex
import statistics
import sys
from pathlib import Path

import model_card
import pandas
from figure_tables import PAGES, TABLES

from slipstitch.config.evaluate import EvaluateSettings
from slipstitch.report.learning import share_interval

ROOT = Path(__file__).parents[1]
NUMBER = r"[−-]?\d[\d.,]*"
SOURCED = re.compile(rf"({NUMBER})<!-- (results/published/[^\s:]+): ([^>]+?) -->")
TABLE = re.compile(r"(<!-- table: (\S+) -->\n)((?:[^<].*\n)*)(<!-- end -->)")
ONCE = re.compile(r"(?:[Mm]easured once|[Ee]stimated): ((?:`[^`]+`(?:,\s|,?\sand\s)?)+)")
NO_RESULTS = re.compile(r"<!-- no results: .+? -->", re.S)
CODE = re.compile(r"^```.*?^```|`[^`\n]+`", re.S | re.M)
RESULT = re.compile(
    rf"(?<![\w.]){NUMBER}\s?(?:%|CPU\b|[MG]i?B\b|times\b|± )|± ?\d|\b\d+ of \d+\b"
    rf"|\b(?:took|takes|costs?)\b[^.|]{{0,60}}?\s{NUMBER}\s(?:ms|s|min|h|seconds|minutes|hours)\b"
    rf"|\| *\**[−<≤]? ?\d*\.\d+[^|\n]*(?=\|)"
)
REDUCED = {
    "min": min,
    "max": max,
    "mean": statistics.fmean,
    "median": statistics.median,
    "sum": sum,
    "len": len,
}


def looked_up(data, pointer):
    """What a JSON pointer names, a list of it where it has a ``*``."""
    for position, part in enumerate(names := pointer.split("/")[1:]):
        if part == "*":
            members = data.values() if isinstance(data, dict) else data
            rest = "".join(f"/{name}" for name in names[position + 1 :])
            return [looked_up(member, rest) for member in members]
        data = data[int(part) if isinstance(data, list) else part]
    return data


def intervals(path, split, network):
    """The interval of the share of right answers, over simulations and seeds, as on the report."""
    columns = ["simulation", "split", "network", "seed", "true_value", "predicted_value"]
    rows = pandas.read_parquet(path, columns=columns).to_dict("records")
    low, high = share_interval(rows, split, network, EvaluateSettings().friction_step)
    return {split: {network: {"low": low, "high": high}}}


def figure(root, file, steps):
    """The figure as text; ValueError or KeyError if the file does not have it."""
    pointer, *steps, form = (step.strip() for step in steps.split("|"))
    if file.endswith(".csv"):
        data = pandas.read_csv(root / file).to_dict("list")
    elif file.endswith(".parquet"):
        data = intervals(root / file, *pointer.split("/")[1:3])
    else:
        data = json.loads((root / file).read_text(encoding="utf-8"))
    value = looked_up(data, pointer)
    for step in steps:
        value = value * float(step[1:]) if step.startswith("*") else REDUCED[step](value)
    return f"{value:{form}}".removesuffix("%").replace("-", "−")


def written_again(text, place, root=ROOT):
    """A page with its figures from the published files, and a line for each complaint."""
    complaints = []

    def at(match):
        line = text.count("\n", 0, match.start()) + 1
        paragraph = (
            text[: match.start()].rpartition("\n\n")[2] + text[match.start() :].split("\n\n")[0]
        )
        sentences = re.split(r"(?<=[.:;|]) |\n(?=[|-])", re.sub(r"<!--.*?-->", "", paragraph))
        number = re.sub(r"<!--.*", "", match[0])
        sentence = next((one for one in sentences if number in one), number)
        return f"{place}:{line}: {' '.join(sentence.split())!r}"

    def again(match):
        try:
            return match[0].replace(match[1], figure(root, match[2], match[3]), 1)
        except (OSError, LookupError, TypeError, ValueError) as error:
            complaints.append(f"{at(match)}: no such figure in {match[2]}: {error!r}")
            return match[0]

    def table(match):
        try:
            return f"{match[1]}{TABLES[match[2]](root)}\n{match[4]}"
        except (OSError, LookupError, TypeError, ValueError) as error:
            complaints.append(f"{at(match)}: table {match[2]} cannot be made: {error!r}")
            return match[0]

    new = TABLE.sub(table, SOURCED.sub(again, text))
    for pattern in (SOURCED, TABLE):
        for old, drifted in zip(pattern.finditer(text), pattern.finditer(new), strict=True):
            if old[0] != drifted[0]:
                now = drifted[1] if pattern is SOURCED else "another table"
                complaints.append(f"{at(old)}: the published file has {now} (make figures)")
    for match in ONCE.finditer(text):
        complaints += [f"{at(match)}: there is no {name}" for name in missing(match[1], root)]
    if place not in PAGES:
        complaints += [f"{at(match)}: a result without a source" for match in unsourced(text)]
    return new, complaints


def unsourced(text):
    """Every match in the text that looks like a result and says nothing of its source."""
    bare = text
    for pattern in (CODE, SOURCED, TABLE):  # blank, so that places stay
        bare = pattern.sub(lambda match: re.sub(r"[^\n]", " ", match[0]), bare)
    starts = [0, *(match.start() for match in re.finditer(r"^#+ ", bare, re.M)), len(text)]
    for start, end in itertools.pairwise(starts):
        section = text[start:end]
        if not ONCE.search(section) and not NO_RESULTS.search(section):
            yield from RESULT.finditer(bare, start, end)


def missing(commands, root):
    """What the commands name and is not there: files, targets, verbs, options."""
    makefile = (root / "Makefile").read_text(encoding="utf-8")
    for command in re.findall(r"`([^`]+)`", commands):
        program, *words = shlex.split(command)
        for word in words:
            if re.fullmatch(r"[\w./-]+\.(?:py|yaml)|tests/[\w/.-]+", word):
                if not (root / word).exists():
                    yield word
                elif word.endswith(".py") and program == "python":
                    yield from unanswered(root / word, words[words.index(word) + 1 :])
        if program == "make" and not re.search(rf"^{re.escape(words[0])}:", makefile, re.M):
            yield f"make {words[0]}"
        if program == "slipstitch":
            yield from refused(words)


def unanswered(script, words):
    """Options that a script requires and the words lack, or that they give and it does not have."""
    known, required = set(), []
    for call in ast.walk(ast.parse(script.read_text(encoding="utf-8"))):
        if isinstance(call, ast.Call) and getattr(call.func, "attr", "") == "add_argument":
            name, options = call.args[0].value, {one.arg: one.value for one in call.keywords}
            known.add(name)
            if getattr(options.get("required"), "value", False) or not name.startswith("-"):
                required.append(name)
    flags = [word for word in words if word.startswith("--")]
    lacking = [name for name in required if name.startswith("-") and name not in flags]
    if not words or words[0].startswith("-"):
        lacking += [name for name in required if not name.startswith("-")]
    for name in [*lacking, *(flag for flag in flags if flag not in known)]:
        yield f"{name} of {script.name}"


def refused(words):
    """Why ``slipstitch`` does not take the words; nothing if it does."""
    from slipstitch.cli.main import VERBS, _parser

    if words[0] not in VERBS:
        yield f"slipstitch {words[0]}"
        return
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            verb = importlib.import_module(f"slipstitch.cli.{words[0]}")
            _parser(words[0], verb).parse_args(words[1:])
    except SystemExit:
        yield f"such command: {said.getvalue().strip()}"


def pages(root=ROOT):
    """``(path, text)`` of README, docs and model card, but for the pages of measured cases."""
    paths = [root / "README.md", root / "CONTRIBUTING.md", root / "config" / "README.md"]
    paths.append(root / model_card.PLACE)
    for path in [*paths, *sorted((root / "docs").glob("*.md"))]:
        yield path.relative_to(root).as_posix(), path.read_text(encoding="utf-8")


def complaints(root=ROOT):
    """A line for every figure of all pages that drifted, or whose source is missing."""
    found = []
    for place, text in pages(root):
        found += written_again(text, place, root)[1]
        if place in PAGES and PAGES[place](root) != text:
            found.append(f"{place}:1: not what is written from its published file (make figures)")
    return found


def main():
    argparse.ArgumentParser(description=__doc__.partition("\n")[0]).parse_args()
    for place, text in pages():
        new = PAGES[place](ROOT) if place in PAGES else written_again(text, place)[0]
        (ROOT / place).write_text(new, encoding="utf-8")
    found = complaints()
    print("\n".join(found), file=sys.stderr)
    raise SystemExit(bool(found))


if __name__ == "__main__":
    main()
