"""What a release says of itself, all of it computed from what it holds: facts and card.

An audit computes it again and compares.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from slipstitch.base.provenance import read_json, read_yaml
from slipstitch.config import Config
from slipstitch.config.catalogue import FLOORS
from slipstitch.dataset.release.card import card_text
from slipstitch.dataset.release.records import (
    VERIFICATION,
    Artefact,
    carried_file,
    is_carried,
    recorded_name,
)
from slipstitch.dataset.release.shards import features_of
from slipstitch.dataset.release.splits import PREFIX, parts_of_splits

KEYWORDS = ("cloth", "friction", "simulation", "video", "material estimation")
LICENCE_URL = "https://spdx.org/licenses/GPL-3.0-or-later"
CITATION = "CITATION.cff"


def facts_of(config: Config, project: Path, date: str) -> dict[str, Any]:
    """Name, version, title and the like, as card, Croissant and crate have them.

    Parameters
    ----------
    config : Config
    project : path
        Folder that holds ``CITATION.cff``.
    date : str
        Day of the release.
    """
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


def sides_of_parts(rows: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, list[str]]]:
    """Split -> side -> parts, from the manifest's rows."""
    names = [name for name in rows[0] if name.startswith(PREFIX)]
    splits = {name.removeprefix(PREFIX): [row[name] for row in rows] for name in names}
    return parts_of_splits(splits, [row["part"] for row in rows])


def card_of(
    folder: Path,
    facts: Mapping[str, Any],
    config: Config,
    rows: Sequence[Mapping[str, Any]],
    artefacts: Mapping[str, Artefact],
    pictures: Mapping[str, str],
) -> str:
    """Text of ``README.md``.

    Parameters
    ----------
    folder : path
        The release; its shards and its carried records are read.
    facts : mapping
        See `facts_of`.
    config : Config
    rows : sequence of mappings
        Its manifest.
    artefacts : mapping
        Path -> record of every file behind it.
    pictures : mapping
        Preview -> what it shows.
    """
    return card_text(
        facts,
        rows,
        sides_of_parts(rows),
        list(features_of(pq.read_schema(folder / rows[0]["shard"]))),
        config=config,
        law=_law(config, artefacts),
        calibration=_calibration(folder, artefacts),
        verification=_verification(folder),
        solver=_solver(artefacts),
        pictures=pictures,
        code=_commits(artefacts),
        versions=versions_of(artefacts),
        example=rows[0]["video"],
    )


def _law(config: Config, artefacts: Mapping[str, Artefact]) -> str | None:
    """Where the release has the extended model of its simulations, if they have one."""
    model = config.simulation.model
    path = recorded_name(model, artefacts) if model else None
    return carried_file(path) if path else None


def _calibration(folder: Path, artefacts: Mapping[str, Artefact]) -> list[dict[str, Any]]:
    """The largest error of each kind of check, beside what is allowed."""
    worst: dict[str, dict[str, Any]] = {}
    for path, artefact in sorted(artefacts.items()):
        if Path(path).name == "calibration.json" and is_carried(artefact):
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
    told = [
        artefact.metadata["solver"]
        for artefact in artefacts.values()
        if artefact.stage == "simulate" and "solver" in artefact.metadata
    ]
    if not told:
        return {}
    return {
        "steps": sum(one["steps"] for one in told),
        "largest_residual": max(one["largest_residual"] for one in told),
    }


def _commits(artefacts: Mapping[str, Artefact]) -> dict[str, Any]:
    records = [
        artefact.provenance for artefact in artefacts.values() if artefact.provenance is not None
    ]
    commits = {record["git_commit"] for record in records if record["git_commit"]}
    return {"commits": sorted(commits), "dirty": any(record["git_dirty"] for record in records)}


def versions_of(artefacts: Mapping[str, Artefact]) -> dict[str, list[str]]:
    """Package -> its versions, of everything behind a release."""
    found: dict[str, set[str]] = defaultdict(set)
    for artefact in artefacts.values():
        for package, version in artefact.record.get("versions", {}).items():
            found[package].add(version)
    return {package: sorted(versions) for package, versions in sorted(found.items())}
