"""Assembling a release in a temporary folder that is renamed at the very end."""

import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from slipstitch.base.errors import BadInput, SlipstitchError
from slipstitch.base.page.wording import time_of_making
from slipstitch.base.project import pinned_versions
from slipstitch.base.provenance import (
    atomic_path,
    file_digest,
    provenance_record,
    start_clock,
    write_json,
)
from slipstitch.config import Config
from slipstitch.config.load import calibrated_settings
from slipstitch.dataset.manifest import MANIFEST, read_manifest
from slipstitch.dataset.release import checksums, currency, manifest, records
from slipstitch.dataset.release.description import CARD, card_of, facts_of
from slipstitch.dataset.release.shards import write_previews, write_shards

_ROOM = 1.02  # records, code and previews come on top of the shards


def check_current(
    artefacts: Mapping[str, records.Artefact], config: Config, root: Path, lock: Mapping[str, str]
) -> None:
    """Refuse to release what code, configuration or catalogue would not make now.

    Simulations are held against the settings that the calibration (below `root`) chose.
    """
    chosen_by = [path for path in artefacts if records.is_calibration(path)]
    calibrated = {path: calibrated_settings(root / path) for path in chosen_by}
    for artefact in artefacts.values():
        if artefact.provenance is None:
            continue
        if artefact.provenance["code_digest"] != currency.current_digest(artefact.stage):
            raise BadInput(
                f"{artefact.path}: made by different code of the stage {artefact.stage}; update "
                "the results with: snakemake --cores 2 sample"
            )
        for problem in currency.other_versions(artefact.record, lock):
            raise BadInput(
                f"{artefact.path}: {problem}; install these versions, or update the lock"
            )
        changed = {
            "configuration": currency.config_changes(artefact, config, calibrated),
            "catalogue": currency.catalogue_changes(artefact),
        }
        for what, changes in changed.items():
            if changes:
                raise BadInput(f"{artefact.path}: made with a different {what}: {changes[0]}")


def _outside(config: Config) -> dict[str, Path]:
    """Name -> place of the files from outside that the configuration names."""
    files = [config.simulation.model, config.render.camera, *config.render.texture_files()]
    return {Path(file).name: Path(file) for file in files if file}


def _check_target(out: Path) -> None:
    if out.is_dir() and not any(out.iterdir()):
        return
    if (out / checksums.SUMS).is_file():
        raise BadInput(f"{out}: contains a release, which is not overwritten; remove it first")
    if out.exists() or out.is_symlink():
        raise BadInput(f"{out}: exists and is not a release; choose another folder")


def _check_room(out: Path, needed: float) -> None:
    place = next(parent for parent in out.resolve().parents if parent.exists())
    free = shutil.disk_usage(place).free
    if free < needed:
        needs = f"about {needed / 1e6:.1f} MB, {free / 1e6:.1f} MB are free on that disk"
        raise SlipstitchError(f"{out}: the release needs {needs}")


def write_release(
    config: Config,
    results: str | os.PathLike,
    out: str | os.PathLike,
    project: str | os.PathLike,
    key: str | os.PathLike | None = None,
) -> dict[str, Any]:
    """Write a release of the sampled dataset, signed if there is an SSH key.

    `results`, with ``sample/``, ``render/`` and the others in it, was made with `config` by the
    code of the checkout `project`; `out` must not exist yet. BadInput if results are missing,
    altered or not up to date, or `out` exists; SlipstitchError if the disk is full: nothing is left
    then. Return the numbers of what was written, and the SHA-256 of its sums.
    """
    started = start_clock()
    results, out = Path(results), Path(out)
    if results.resolve().name != "results":
        raise BadInput(f"{results}: must be a folder named results, as in the records")
    _check_target(out)
    if key is not None:
        checksums.check_key(key)
    project = currency.check_project(project)
    sample = results / "sample"
    sampled, _ = read_manifest(sample)
    made = [records.SAMPLED_MANIFEST]
    if (results.parent / records.VERIFICATION).is_file():
        made.append(records.VERIFICATION)
    artefacts = records.collect(made, results.parent, _outside(config))
    lock = {
        name.lower(): version for name, version in pinned_versions(project / currency.LOCK).items()
    }
    check_current(artefacts, config, results.parent, lock)
    copied = [sample / name for name in {row["file"] for row in sampled}]
    copied += [results.parent / path for path, one in artefacts.items() if one.stage == "simulate"]
    _check_room(out, _ROOM * sum(path.stat().st_size for path in copied))
    try:
        with atomic_path(out) as folder:
            folder.mkdir()
            return _fill(folder, config, results, sampled, artefacts, project, started, key)
    except OSError as error:
        raise SlipstitchError(f"{out}: cannot be written: {error.strerror or error}") from None


def _fill(
    folder: Path,
    config: Config,
    results: Path,
    sampled: list[dict[str, Any]],
    artefacts: dict[str, records.Artefact],
    project: Path,
    started: tuple[float, float],
    key: str | os.PathLike | None,
) -> dict[str, Any]:
    sample = results / "sample"
    splits = manifest.split_columns(sampled, config)
    part_of = manifest.parts(splits)
    part_of_video = {row["video"]: part for row, part in zip(sampled, part_of, strict=True)}
    places = write_shards(sample, sampled, part_of_video, folder, config.release.shard_mb)
    rows = manifest.released_rows(sampled, splits, part_of, places)
    manifest.write_manifest(rows, list(splits), folder)
    pictures = write_previews(folder, rows)
    currency.copy_code(project, folder)
    facts = facts_of(config, project, time_of_making().date().isoformat())
    _write_records(folder, config, results, artefacts)
    parts = manifest.parts_of_splits(splits, part_of)
    card = card_of(folder, facts, config, rows, parts, artefacts, pictures)
    (folder / CARD).write_text(card, encoding="utf-8")
    # rdflib and rocrate take a second to import.
    from slipstitch.dataset.release.metadata import crate_text, croissant_text

    (folder / records.CROISSANT).write_text(croissant_text(folder, facts), encoding="utf-8")
    record = provenance_record(
        "release",
        config={"release": config.release, "seed": config.seed},
        seed=config.seed,
        started=started,
    )
    # As the other records call it, whatever the working folder.
    record["inputs"] = {records.SAMPLED_MANIFEST: file_digest(sample / MANIFEST)}
    (folder / records.CRATE).write_text(
        crate_text(folder, facts, artefacts, record), encoding="utf-8"
    )
    content = {name: file_digest(folder / name) for name in checksums.files_below(folder)}
    write_json(
        folder / records.RELEASE_RECORD, {"facts": facts, "files": content, "provenance": record}
    )
    digest = checksums.write_sums(folder)
    files = [*checksums.files_below(folder), checksums.SUMS]
    if key is not None:
        checksums.sign(folder, key)
        files.append(checksums.SIGNATURE)
    for name in files:
        (folder / name).chmod(0o444)
    return {
        "videos": len(rows),
        "images": sum(row["frames"] for row in rows),
        "files": len(files),
        "size_bytes": sum((folder / name).stat().st_size for name in files),
        "sums_sha256": digest,
    }


def _write_records(
    folder: Path, config: Config, results: Path, artefacts: Mapping[str, records.Artefact]
) -> None:
    for path, artefact in artefacts.items():
        records.write_record(artefact, folder)
        if records.is_carried(artefact):
            carried = folder / records.carried_file(path)
            carried.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(records.locate(path, results.parent, _outside(config)), carried)
    write_json(folder / records.CONFIG, config.model_dump(mode="json"))
    if (results / "grid.parquet").is_file():
        shutil.copyfile(results / "grid.parquet", folder / records.GRID)
