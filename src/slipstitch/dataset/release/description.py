"""What a release says of itself, computed from what it holds: facts, and the card README.md."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from slipstitch.base.page.templates import render
from slipstitch.base.provenance import read_json, read_yaml
from slipstitch.config import Config
from slipstitch.config.catalogue import FLOORS
from slipstitch.dataset.release import manifest
from slipstitch.dataset.release.manifest import PREFIX, SAMPLED
from slipstitch.dataset.release.records import (
    VERIFICATION,
    Artefact,
    carried_file,
    is_calibration,
    recorded_name,
)
from slipstitch.dataset.videos import DATASET_SCHEMA
from slipstitch.design.splits import SIDES

KEYWORDS = ("cloth", "friction", "simulation", "video", "material estimation")
LICENCE_URL = "https://spdx.org/licenses/GPL-3.0-or-later"
CITATION = "CITATION.cff"
CARD = "README.md"
_TEMPLATE = Path(__file__).with_name("card.md.j2")
_NO_LABELS = frozenset(
    {"video", "pixels_sha256", "simulation", "frames", "pixels", "part", "shard", "first_row"}
)
_NO_LABEL_PREFIXES = (PREFIX, SAMPLED)
_MOST_VALUES = 24
_COUNTED = ("simulation", "material", "friction", "frames", "pixels")
_SIZES = ((1e3, "n<1K"), (1e4, "1K<n<10K"), (1e5, "10K<n<100K"), (1e6, "100K<n<1M"))


def front_matter(
    facts: Mapping[str, Any],
    images: int,
    parts: Mapping[str, Mapping[str, Sequence[str]]],
    default: str,
) -> str:
    """The YAML block by which Hugging Face datasets finds the splits."""
    configs: dict[str, dict[str, Any]] = {}
    files: dict[tuple[str, str], list[str] | str] = {
        (split, side): [f"data/{part}-*.parquet" for part in names]
        for split, sides in parts.items()
        for side, names in sides.items()
    }
    files["everything", "videos"] = "data/part*.parquet"
    for (split, side), path in files.items():
        entry = configs.setdefault(split, {"config_name": split, "data_files": []})
        entry["data_files"].append({"split": side, "path": path})
    configs[default]["default"] = True
    size = next((name for bound, name in _SIZES if images < bound), "1M<n<10M")
    content = {
        "license": "gpl-3.0",
        "pretty_name": facts["title"],
        "task_categories": ["video-classification", "image-classification"],
        "tags": list(facts["keywords"]),
        "size_categories": [size],
        "configs": list(configs.values()),
    }
    return yaml.safe_dump(content, sort_keys=False, allow_unicode=True)


def split_table(rows: Sequence[Mapping[str, Any]], names: Sequence[str]) -> list[dict[str, Any]]:
    """For every split: its question and the numbers of videos and simulations on each side."""
    table = []
    for name in names:
        sides = {}
        for side in SIDES:
            chosen = [row["simulation"] for row in rows if row[PREFIX + name] == side]
            sides[side] = (len(chosen), len(set(chosen)))
        table.append({"name": name, "question": manifest.question(name), "sides": sides})
    return table


def varied(rows: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Variation of the videos: column of labels -> its values or range, test-only ones marked."""
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


def facts_of(config: Config, project: Path, date: str) -> dict[str, Any]:
    """Name, version, title and the like, as card, Croissant and crate have them."""
    citation = read_yaml(project / CITATION)
    paper = citation["references"][0]
    settings = config.release
    return {
        "name": settings.name,
        "version": settings.version,
        "title": "Cloth dropped and dragged over a floor, by friction coefficient",
        "description": "Rendered videos of simulated cloth that is lowered onto a floor and "
        "dragged over it, labelled with the friction coefficient and the fabric.",
        "licence_url": LICENCE_URL,
        "citation": f"{citation['title']}, version {citation['version']}; method after: "
        f"{paper['title']}, {paper['collection-title']}, {paper['year']}",
        "date": date,
        "keywords": list(KEYWORDS),
    }


def card_of(
    folder: Path,
    facts: Mapping[str, Any],
    config: Config,
    rows: Sequence[Mapping[str, Any]],
    parts: Mapping[str, Mapping[str, Sequence[str]]],
    artefacts: Mapping[str, Artefact],
    pictures: Mapping[str, str],
) -> str:
    """Text of ``README.md``, from the manifest's rows, the splits' parts and carried records."""
    # The split that is loaded if none is named.
    default = "by_simulation" if "by_simulation" in parts else next(iter(parts))
    images = sum(row["frames"] for row in rows)
    law = config.simulation.model and recorded_name(config.simulation.model, artefacts)
    records = [one.record for one in artefacts.values() if one.provenance is not None]
    return render(
        _TEMPLATE,
        front_matter=front_matter(facts, images, parts, default),
        facts=facts,
        default=default,
        images=images,
        videos=len(rows),
        values={name: sorted({row[name] for row in rows}) for name in _COUNTED},
        varied=varied(rows),
        splits=split_table(rows, list(parts)),
        sides=SIDES,
        manifest_columns=[(name, manifest.described(name)) for name in rows[0]],
        frame_columns=[(name, manifest.described(name)) for name in DATASET_SCHEMA.names],
        config=config,
        law=law and carried_file(law),
        calibration=_calibration(folder, artefacts),
        verification=_verification(folder),
        solver=_solver(artefacts),
        pictures=pictures,
        code={
            "commits": sorted({one["git_commit"] for one in records if one["git_commit"]}),
            "dirty": any(one["git_dirty"] for one in records),
        },
        versions=_versions(records),
        example=rows[0]["video"],
    )


def _calibration(folder: Path, artefacts: Iterable[str]) -> list[dict[str, Any]]:
    """The largest error of each kind of check, beside what is allowed."""
    worst: dict[str, dict[str, Any]] = {}
    for path in sorted(filter(is_calibration, artefacts)):
        for check in read_json(folder / carried_file(path))["checks"]:
            unit = "(relative)" if check["relative"] else check["unit"]
            kept = worst.get(check["name"])
            if kept is None or check["error"] > kept["error"]:
                worst[check["name"]] = {**check, "unit": unit}
    return list(worst.values())


def _verification(folder: Path) -> list[dict[str, Any]]:
    """How near composed images are to direct renders: floors that do not mirror, and that do."""
    path = folder / carried_file(VERIFICATION)
    if not path.is_file():
        return []
    kinds: dict[str, list[dict]] = {"matte": [], "mirrors": []}
    for compared in read_json(path)["comparisons"]:
        kind = "matte" if FLOORS[compared["floor"]].reflectance[1] == 0 else "mirrors"
        kinds[kind].append(compared)
    return [
        {
            "floor": kind,
            "images": len(of_kind),
            "least_psnr_db": of_kind[0]["least_psnr_db"],
            "lowest_psnr_db": min(compared["psnr_db"] for compared in of_kind),
            "mean_psnr_db": sum(compared["psnr_db"] for compared in of_kind) / len(of_kind),
            "lowest_ssim": min(compared["ssim"] for compared in of_kind),
        }
        for kind, of_kind in kinds.items()
        if of_kind
    ]


def _solver(artefacts: Mapping[str, Artefact]) -> dict[str, Any]:
    """Time steps of all simulations together, and the largest residual of any."""
    simulated = [one.metadata for one in artefacts.values() if one.stage == "simulate"]
    told = [metadata["solver"] for metadata in simulated if "solver" in metadata]
    if not told:
        return {}
    largest = max(one["largest_residual"] for one in told)
    return {"steps": sum(one["steps"] for one in told), "largest_residual": largest}


def _versions(records: Sequence[Mapping[str, Any]]) -> dict[str, list[str]]:
    """Package -> its versions, of everything behind a release."""
    found: dict[str, set[str]] = defaultdict(set)
    for record in records:
        for package, version in (record.get("versions") or {}).items():
            found[package].add(version)
    return {package: sorted(versions) for package, versions in sorted(found.items())}
