"""The dataset card: README.md with figures, limits and code to load the data."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from slipstitch.base.page.templates import render
from slipstitch.dataset.release.manifest import SAMPLED, described
from slipstitch.dataset.release.splits import PREFIX, question
from slipstitch.design.splits import SIDES

CARD = "README.md"
_TEMPLATE = Path(__file__).with_name("card.md.j2")
_NO_LABELS = frozenset(
    {"video", "pixels_sha256", "simulation", "frames", "pixels", "part", "shard", "first_row"}
)
_NO_LABEL_PREFIXES = (PREFIX, SAMPLED)
_MOST_VALUES = 24
_SIZES = ((1e3, "n<1K"), (1e4, "1K<n<10K"), (1e5, "10K<n<100K"), (1e6, "100K<n<1M"))


def _size_category(images: int) -> str:
    return next((name for bound, name in _SIZES if images < bound), "1M<n<10M")


def data_files(
    parts: Mapping[str, Mapping[str, Sequence[str]]],
) -> dict[tuple[str, str], list[str] | str]:
    """(Split, side) -> patterns of the files that Hugging Face datasets loads for it."""
    files: dict[tuple[str, str], list[str] | str] = {
        (split, side): [f"data/{part}-*.parquet" for part in names]
        for split, sides in parts.items()
        for side, names in sides.items()
    }
    files["everything", "videos"] = "data/part*.parquet"
    return files


def front_matter(
    facts: Mapping[str, Any],
    images: int,
    parts: Mapping[str, Mapping[str, Sequence[str]]],
    default: str,
) -> str:
    """The YAML block by which Hugging Face datasets finds the splits."""
    configs: dict[str, dict[str, Any]] = {}
    for (split, side), path in data_files(parts).items():
        entry = configs.setdefault(split, {"config_name": split, "data_files": []})
        entry["data_files"].append({"split": side, "path": path})
    configs[default]["default"] = True
    content = {
        "license": "gpl-3.0",
        "pretty_name": facts["title"],
        "task_categories": ["video-classification", "image-classification"],
        "tags": list(facts["keywords"]),
        "size_categories": [_size_category(images)],
        "configs": list(configs.values()),
    }
    return yaml.safe_dump(content, sort_keys=False, allow_unicode=True)


def split_table(rows: Sequence[Mapping[str, Any]], names: Sequence[str]) -> list[dict[str, Any]]:
    """For every split: its question and the numbers of videos and simulations on each side."""
    table = []
    for name in names:
        sides = {}
        for side in SIDES:
            chosen = [row for row in rows if row[PREFIX + name] == side]
            sides[side] = (len(chosen), len({row["simulation"] for row in chosen}))
        table.append({"name": name, "question": question(name), "sides": sides})
    return table


def varied(rows: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Variation of the videos: column of labels -> its values, test-only ones marked.

    Numbers of many values are shown by their range. Ids, digests, places and splits are no labels.
    """
    shown = {}
    for name in rows[0]:
        values = list(dict.fromkeys(row[name] for row in rows if row[name] is not None))
        if name in _NO_LABELS or name.startswith(_NO_LABEL_PREFIXES) or name.endswith("_role"):
            continue
        if name.endswith("_id") or len(values) < 2:
            continue
        if len(values) > _MOST_VALUES:
            if all(isinstance(value, int | float) for value in values):
                shown[name] = f"{min(values):.4g} ... {max(values):.4g}"
            continue
        role = f"{name}_role"
        test_only = {row[name] for row in rows if row.get(role) == "test"}
        words = [f"{value} (test-only)" if value in test_only else f"{value}" for value in values]
        shown[name] = ", ".join(words)
    return shown


def default_split(parts: Mapping[str, Any]) -> str:
    """The split that is loaded if none is named."""
    return "by_simulation" if "by_simulation" in parts else next(iter(parts))


def card_text(facts: Mapping[str, Any], rows, parts, frame_columns, **more) -> str:
    """Text of ``README.md``.

    Parameters
    ----------
    facts : mapping
    rows : sequence of mappings
        The release's manifest.
    parts : mapping
        Split -> side -> parts.
    frame_columns : sequence of str
        Columns of the shards.
    **more
        What else the template shows: ``config, law, calibration, verification, solver, pictures,
        code, versions, example``; ``law`` is the place of the extended model, None without one.
    """
    default = default_split(parts)
    images = sum(row["frames"] for row in rows)
    return render(
        _TEMPLATE,
        front_matter=front_matter(facts, images, parts, default),
        facts=facts,
        default=default,
        images=images,
        videos=len(rows),
        values={
            name: sorted({row[name] for row in rows})
            for name in ("simulation", "material", "friction")
        },
        varied=varied(rows),
        frames=sorted({row["frames"] for row in rows}),
        pixels=sorted({row["pixels"] for row in rows}),
        splits=split_table(rows, list(parts)),
        sides=SIDES,
        manifest_columns=[(name, described(name)) for name in rows[0]],
        frame_columns=[(name, described(name)) for name in frame_columns],
        **more,
    )
