"""What a release says of itself, made again from what it holds: any other text or picture is found.

Card, Croissant, crate, previews, grid and facts follow from manifest, shards, records and
configuration by code; so does which files there are.
"""

import datetime
import difflib
import io
import json
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from PIL import Image

from slipstitch.base.errors import first_line
from slipstitch.base.page.wording import shortened
from slipstitch.base.provenance.reading import load_yaml
from slipstitch.config import Config
from slipstitch.dataset.audit.admission import UNUSABLE, check_parquet
from slipstitch.dataset.audit.contents import Contents
from slipstitch.dataset.audit.findings import Finding, Kind
from slipstitch.dataset.audit.png import png_problem
from slipstitch.dataset.manifest import MANIFEST_SCHEMA
from slipstitch.dataset.release import card, previews
from slipstitch.dataset.release.checksums import SUMS
from slipstitch.dataset.release.code import CODE, COPIED, locked_versions
from slipstitch.dataset.release.currency import current_digest, other_versions
from slipstitch.dataset.release.description import CITATION, card_of, facts_of, sides_of_parts
from slipstitch.dataset.release.manifest import MANIFEST, notes_of, released_schema
from slipstitch.dataset.release.records import (
    CONFIG,
    CRATE,
    CROISSANT,
    GRID,
    RELEASE_RECORD,
    carried_file,
    is_carried,
    record_file,
    table_digest,
)
from slipstitch.dataset.release.splits import PREFIX
from slipstitch.design.grid_table import grid_table

_BESIDE = (card.CARD, "LICENSE", CITATION, CROISSANT, CRATE, MANIFEST)


def check_derived(contents: Contents) -> tuple[list[Finding], list[str]]:
    """Compare what a release says of itself with what it holds.

    Returns
    -------
    findings : list of Finding
        All of kind BROKEN, or UNEXPLAINED for files that no release has.
    notes : list of str
        What could not be made again, and why.
    """
    config = contents.config
    if not contents.rows or config is None:
        return [], ["without manifest and configuration, nothing can be regenerated and compared"]
    findings = [*_files(contents), *_manifest(contents), *_head(contents), *_copies(contents)]
    findings += _grid(contents, config)
    made_by = contents.release.get("provenance", {}).get("code_digest")
    if made_by != current_digest("release"):
        note = "card, Croissant, crate and previews come from a different version of release: "
        return findings, [note + "only the splits in the card's header are compared"]
    drawn: dict[str, tuple[str, Image.Image]] = {}
    made: list[tuple[str, Callable[[], Iterator[Finding]]]] = [
        (RELEASE_RECORD, lambda: _facts(contents, config)),
        ("previews", lambda: _previews(contents, drawn)),
        (card.CARD, lambda: _card(contents, config, drawn)),
        (CROISSANT, lambda: _croissant(contents)),
        (CRATE, lambda: _crate(contents)),
    ]
    for name, check in made:
        try:
            findings += check()
        except UNUSABLE as error:
            what = f"cannot be regenerated from the records: {first_line(error)}"
            findings.append(Finding(Kind.BROKEN, name, what))
    return findings, []


def _files(contents: Contents) -> Iterator[Finding]:
    """Files that a release of these clips and records does not have."""
    expected = {*_BESIDE, SUMS, CONFIG, GRID, RELEASE_RECORD}
    expected |= {row["shard"] for row in contents.rows}
    expected |= {f"{previews.FOLDER}/{name}.png" for name in previews.NAMES}
    for path, artefact in contents.artefacts.items():
        expected |= {record_file(path)} | ({carried_file(path)} if is_carried(artefact) else set())
    code = tuple(f"{CODE}/{name}" for name in COPIED)
    for name in sorted(set(contents.sums) - expected):
        if not (name in code or name.startswith(tuple(f"{folder}/" for folder in code))):
            yield Finding(Kind.UNEXPLAINED, name, "not a file of a release")
    for name in (*_BESIDE, CONFIG, RELEASE_RECORD, f"{CODE}/Snakefile"):
        if name not in contents.sums:
            yield Finding(Kind.MISSING, name, "required in every release")


def _manifest(contents: Contents) -> Iterator[Finding]:
    """Columns and notes of the manifest, names of the shards."""
    names = [name for name in contents.rows[0] if name.startswith(PREFIX)]
    splits = [name.removeprefix(PREFIX) for name in names]
    expected = released_schema(MANIFEST_SCHEMA, splits)
    schema = contents.schema
    if schema is not None and not schema.equals(expected, check_metadata=False):
        odd = sorted(set(schema.names) ^ set(expected.names)) or ["their order or types"]
        yield Finding(Kind.BROKEN, MANIFEST, f"its columns are not those of a manifest: {odd[0]}")
    if contents.notes != notes_of(contents.rows, MANIFEST_SCHEMA, splits):
        yield Finding(Kind.BROKEN, MANIFEST, "its metadata do not match its rows")
    shards: dict[str, list[str]] = defaultdict(list)
    for row in contents.rows:
        if row["shard"] not in shards[row["part"]]:
            shards[row["part"]].append(row["shard"])
    for part, found in sorted(shards.items()):
        count = len(found)
        named = {f"data/{part}-{number:05d}-of-{count:05d}.parquet" for number in range(count)}
        for shard in sorted(set(found) - named):
            clips = tuple(row["video"] for row in contents.rows if row["shard"] == shard)
            what = f"contains clips of {part}, whose {count} shards have other names"
            yield Finding(Kind.BROKEN, shard, what, clips)


def _head(contents: Contents) -> Iterator[Finding]:
    """Which files the card's head loads as which side of which split."""
    try:
        text = (contents.folder / card.CARD).read_text(encoding="utf-8")
        configs = load_yaml(text.split("---\n")[1], card.CARD)["configs"]
        found = {
            (entry["config_name"], one["split"]): sorted(one["path"])
            if isinstance(one["path"], list)
            else one["path"]
            for entry in configs
            for one in entry["data_files"]
        }
    except UNUSABLE as error:
        what = f"its header names no splits: {first_line(error)}"
        yield Finding(Kind.BROKEN, card.CARD, what)
        return
    expected = card.data_files(sides_of_parts(contents.rows))
    for split, side in sorted({*found, *expected}):
        one, other = found.get((split, side)), expected.get((split, side))
        if one != other:
            clips = tuple(r["video"] for r in contents.rows if r.get(f"{PREFIX}{split}") == side)
            what = f"its header loads {one} as {side} of {split}; the manifest has {other} there"
            yield Finding(Kind.BROKEN, card.CARD, what, clips)


def _copies(contents: Contents) -> Iterator[Finding]:
    for name in ("LICENSE", CITATION):
        one, other = contents.folder / name, contents.folder / CODE / name
        if one.is_file() and other.is_file() and one.read_bytes() != other.read_bytes():
            yield Finding(Kind.BROKEN, name, f"is not the one in {CODE}/")


def _grid(contents: Contents, config: Config) -> Iterator[Finding]:
    path = contents.folder / GRID
    if not path.is_file():
        return
    expected = grid_table(config)
    try:
        check_parquet(path, images=False)
        same = table_digest(pq.read_table(path)) == table_digest(expected)
    except UNUSABLE as error:
        what = f"cannot be read: {str(error).removeprefix(f'{path}: ')}"
        yield Finding(Kind.BROKEN, GRID, what)
        return
    if not same:
        yield Finding(Kind.BROKEN, GRID, "is not the grid of records/config.json")


def _facts(contents: Contents, config: Config) -> Iterator[Finding]:
    stated = contents.release["facts"]
    date = str(stated.get("date"))
    datetime.date.fromisoformat(date)
    expected = facts_of(config, contents.folder / CODE, date)
    if stated != expected:
        odd = next(key for key in {**expected, **stated} if stated.get(key) != expected.get(key))
        what = f"{odd} is not what configuration and citation give"
        yield Finding(Kind.BROKEN, RELEASE_RECORD, what)
    record = contents.release["provenance"]
    settings = config.model_dump(mode="json", include={"release", "seed"})
    manifest = f"results/sample/{MANIFEST}"
    made_from = contents.artefacts.get(manifest)
    expected_record = {
        "stage": "release",
        "config": settings,
        "seed": config.seed,
        "inputs": {manifest: made_from.sha256 if made_from else None},
    }
    for key, value in expected_record.items():
        if record.get(key) != value:
            yield Finding(Kind.BROKEN, RELEASE_RECORD, f"its {key} does not match the release")
    for problem in other_versions(record, locked_versions(contents.folder / CODE)):
        yield Finding(Kind.BROKEN, RELEASE_RECORD, problem)


def _card(
    contents: Contents, config: Config, drawn: Mapping[str, tuple[str, Any]]
) -> Iterator[Finding]:
    pictures = {path: words for path, (words, _) in drawn.items()}
    text = card_of(
        contents.folder,
        contents.release["facts"],
        config,
        contents.rows,
        contents.artefacts,
        pictures,
    )
    yield from _same_text(contents, card.CARD, text)


def _same_text(contents: Contents, name: str, expected: str) -> Iterator[Finding]:
    found = (contents.folder / name).read_text(encoding="utf-8")
    if found == expected:
        return
    lines = difflib.ndiff(expected.splitlines(), found.splitlines())
    odd = next((line for line in lines if line[0] in "+-"), "  ")
    said = f"{'says' if odd[0] == '+' else 'lacks'} {shortened(odd[2:], 80)!r}"
    yield Finding(Kind.BROKEN, name, f"does not match manifest and records: {said}")


def _croissant(contents: Contents) -> Iterator[Finding]:
    from slipstitch.dataset.release.croissant import (
        croissant_text,  # rdflib takes a second to import
    )

    text = croissant_text(contents.folder, contents.release["facts"])
    yield from _same_json(contents, CROISSANT, text)


def _crate(contents: Contents) -> Iterator[Finding]:
    facts, record = contents.release["facts"], contents.release["provenance"]
    from slipstitch.dataset.release.crate import crate_text

    text = crate_text(contents.folder, facts, contents.artefacts, record)
    yield from _same_json(contents, CRATE, text)


def _same_json(contents: Contents, name: str, text: str) -> Iterator[Finding]:
    """The terms of a JSON-LD context are the library's: another release may write others."""
    raw = (contents.folder / name).read_text(encoding="utf-8")
    if raw == text:
        return
    found, expected = json.loads(raw), json.loads(text)
    for key in sorted({*found, *expected} - {"@context"}):
        if found.get(key) != expected.get(key):
            odd = _first_difference(expected.get(key), found.get(key), key)
            yield Finding(Kind.BROKEN, name, f"does not match the release: {odd}")
            return


def _first_difference(expected: Any, found: Any, where: str) -> str:
    """Where two structures differ first: by key, by ``@id`` in lists of entities."""
    if isinstance(expected, dict) and isinstance(found, dict):
        for key in {**expected, **found}:
            if expected.get(key) != found.get(key):
                return _first_difference(expected.get(key), found.get(key), f"{where}, {key}")
    if isinstance(expected, list) and isinstance(found, list):
        for one, other in zip(expected, found, strict=False):
            if one != other:
                name = one.get("@id", "") if isinstance(one, dict) else ""
                return _first_difference(one, other, str(name) or where)
    return where


def _previews(contents: Contents, drawn: dict[str, tuple[str, Image.Image]]) -> Iterator[Finding]:
    drawn |= previews.draw_previews(contents.folder, contents.rows)
    versions = contents.release["provenance"]["versions"]
    same_letters = versions.get("pillow") == Image.__version__
    for path, (_, picture) in drawn.items():
        data = (contents.folder / path).read_bytes()
        problem = png_problem(data, picture.size)
        if problem:
            yield Finding(Kind.BROKEN, path, problem)
            continue
        # Letters are drawn by Pillow: another version's may differ.
        top, left = (0, 0) if same_letters else (previews.TOP, previews.LEFT)
        with Image.open(io.BytesIO(data)) as image:
            found = np.asarray(image)
        if not np.array_equal(found[top:, left:], np.asarray(picture)[top:, left:]):
            yield Finding(Kind.BROKEN, path, "does not show the images of the shards")
