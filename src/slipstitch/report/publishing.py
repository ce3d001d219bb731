"""A run's results as a small folder to keep: scores, curves, page, costs, models, origin."""

import contextlib
import json
import os
import re
import shutil
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas

from slipstitch.base.errors import BadInput, Damaged
from slipstitch.base.provenance import (
    atomic_path,
    check_recorded,
    file_digest,
    provenance_record,
    read_json,
    read_parquet,
    read_provenance,
    start_clock,
)
from slipstitch.base.provenance.reading import SIDECAR_SUFFIX
from slipstitch.base.provenance.record import write_json
from slipstitch.config import Config, load_config
from slipstitch.config.simulation import SimulationSettings
from slipstitch.dataset.audit.scored import SCORES, SCORES_OF, and_more, compare
from slipstitch.dataset.manifest import MANIFEST, read_manifest
from slipstitch.physics.simulation.convergence import measured_convergence
from slipstitch.physics.simulation.trajectory import read_trajectory
from slipstitch.report.results import STAGES, Results
from slipstitch.report.status.state import read_benchmark

INDEX = "published.json"
# In the folder of the results, as records call files elsewhere by their names alone.
_AGAIN = "run slipstitch evaluate again, in the folder that contains the results"
# What the workflow keeps below the results beside its stages.
_KEPT = (*STAGES, "ablate", "captures", "benchmarks", "logs")
_PAGES = ("report/index.html", "captures/index.html")
#: Beside what a finished run must have; there if the target `ablate` or `captures` was run.
OPTIONAL = (
    "ablate/ablate.json",
    "captures/index.html",
    "captures/metrics.json",
    "captures/predictions.parquet",
)

#: Made from all images and trajectories: of an update, whose results may have no longer all.
_OF_ALL = ("cost.json", "simulations.csv", "dataset/digests.json", "dataset/lineage.json")


def finished_files(config: Config) -> dict[str, str]:
    """Files of a finished run, below its results -> where they are published."""
    files = {
        "evaluate/metrics.json": "metrics.json",
        "evaluate/details.json": "details.json",
        "evaluate/predictions.parquet": "predictions.parquet",
        "report/index.html": "index.html",
        "calibrate/calibration.json": "calibration.json",
        f"sample/{MANIFEST}": f"dataset/{MANIFEST}",
    }
    for split in config.train.splits:
        for network, seed in config.train.trainings(split):
            folder = f"{split}/{network}/seed{seed}"
            files |= _model(f"train/{folder}", f"models/{folder}", "model")
        for seed in config.instrument.seeds:
            folder = f"{split}/seed{seed}"
            to = f"models/{split}/instrument/seed{seed}"
            files |= _model(f"instrument/{folder}", to, "instrument")
        if len(config.instrument.seeds) > 1:
            to = f"models/{split}/instrument/ensemble"
            files |= {
                f"instrument/{split}/ensemble/{file}": f"{to}/{file}"
                for file in (
                    "instrument.safetensors",
                    "instrument.json",
                    "calibration.parquet",
                    "readings.parquet",
                )
            }
    return files


def further_datasets(config: Config, results: Path) -> dict[str, Path]:
    """Where datasets that calibrate an average besides are published -> their folders."""
    return {
        f"calibration_datasets/{number}": results.parent / folder
        for number, folder in enumerate(config.instrument.calibration_datasets)
    }


def _model(folder: str, to: str, name: str) -> dict[str, str]:
    """Weights, card and training curve."""
    names = (f"{name}.safetensors", f"{name}.json", "history.csv")
    return {f"{folder}/{file}": f"{to}/{file}" for file in names}


def publish(
    config: Config,
    results: str | os.PathLike,
    out: str | os.PathLike,
    partial: bool = False,
    update: bool = False,
) -> dict[str, Any]:
    """Write the folder, whole or not at all.

    Parameters
    ----------
    config : Config
        What the results were made with.
    results : path
    out : path
        Absent, empty, or a folder that was published before and is replaced.
    partial : bool
        Publish an unfinished run, with what it lacks said at the head of every page: files, and
        scores of models that were trained after the evaluation.
    update : bool
        Keep what the folder has and the results have no longer, as images' digests whose files were
        deleted since: of the same dataset and configuration.

    Returns
    -------
    dict
        The content of ``published.json``: ``name``, ``partial``, ``missing`` and SHA-256 of every
        file.

    Raises
    ------
    BadInput
        If `out` holds anything else, or results; if the run is not finished, without `partial`; if
        there is nothing of it; if a file is damaged; if the scores are of other models or of
        another dataset; with `update` if `out` is of another run.
    """
    started = start_clock()
    found = Results(results, config)
    _check_target(Path(out), found.folder)
    wanted = finished_files(config)
    further = further_datasets(config, found.folder)
    kept = _kept(config, found, Path(out)) if update else set()
    missing = sorted(
        name
        for name, to in wanted.items()
        if not (found.folder / name).is_file() and to not in kept
    )
    missing += [
        f"{place}/{MANIFEST}"
        for place, sample in further.items()
        if not (sample / MANIFEST).is_file() and f"{place}/{MANIFEST}" not in kept
    ]
    if not kept and not any((found.folder / name).is_file() for name in wanted):
        raise BadInput(f"{results}: nothing of a run in it")
    if missing and not partial:
        raise BadInput(
            f"{results}: not finished: {missing[0]} is missing ({len(missing)} of "
            f"{len(wanted) + len(further)} files); --partial publishes what is there, marked on "
            "every page"
        )
    there = {
        name: to
        for name, to in {**wanted, **{name: name for name in OPTIONAL}}.items()
        if (found.folder / name).is_file()
    }
    for name in there:
        _check_file(found.folder / name)
    digests = {name: file_digest(found.folder / name) for name in there}
    before = {name: file_digest(Path(out) / name) for name in kept}
    unscored = [name for name in _unscored(found.folder, before | digests) if name in there]
    if unscored and not partial:
        raise BadInput(
            f"{results}: the scores do not include {and_more(unscored)}; {_AGAIN}, or "
            "publish with --partial, which says so on every page"
        )
    missing += [SCORES_OF + there[name] for name in unscored]
    with atomic_path(out) as folder:
        for name, to in there.items():
            _copy(found.folder / name, folder / to, missing if name in _PAGES else [])
        inputs = [found.folder / name for name in there]
        record = provenance_record("publish", inputs=inputs, config=config, started=started)
        write_json(folder / "config.json", config.model_dump(mode="json"))
        write_json(folder / "cost.json", list(_costs(found)))
        if solved := list(_simulations(found)):
            pandas.DataFrame(solved).to_csv(folder / "simulations.csv", index=False)
        write_json(folder / "origin.json", dict(found.provenance()))
        if "sample/" + MANIFEST in there:
            _describe_dataset(found.folder / "sample", folder / "dataset")
        for place, sample in further.items():
            if (sample / MANIFEST).is_file():
                _describe_dataset(sample, folder / place)
                _copy(sample / MANIFEST, folder / place / MANIFEST, [])
        if update:
            _keep(Path(out), folder, kept, there)
        index = {
            "name": config.publish.name,
            "partial": bool(missing),
            "missing": missing,
            "files": {
                path.relative_to(folder).as_posix(): file_digest(path)
                for path in sorted(folder.rglob("*"))
                if path.is_file()
            },
        }
        write_json(folder / INDEX, index, record)
    return index


def _kept(config: Config, results: Results, out: Path) -> set[str]:
    """What a folder published before keeps; BadInput if it is of another run."""
    if not (out / INDEX).is_file():
        raise BadInput(f"{out}: nothing published there to update: publish without --update")
    if _of_run(load_config(out / "config.json")) != _of_run(config):
        raise BadInput(f"{out}: published with another configuration; publish without --update")
    manifest = results.folder / "sample" / MANIFEST
    before = out / "dataset" / MANIFEST
    if manifest.is_file() and before.is_file() and file_digest(manifest) != file_digest(before):
        raise BadInput(f"{out}: published of another dataset; publish without --update")
    own = {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()}
    return own - {INDEX, INDEX + SIDECAR_SUFFIX}


def _of_run(config: Config) -> Config:
    """The configuration but for what calibrates an average besides, which alters nothing else."""
    instrument = config.instrument.model_copy(update={"calibration_datasets": []})
    return config.model_copy(update={"instrument": instrument})


def _keep(before: Path, folder: Path, kept: Iterable[str], there: Mapping[str, str]) -> None:
    """Put into a new folder what the one before has of results that are gone."""
    # Records of what is there again, but not published anew, are not those of the published files.
    anew = {name: one for name, one in read_json(folder / "origin.json").items() if name in there}
    for name in kept:
        to = folder / name
        if name in _OF_ALL or not to.exists():
            to.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(before / name, to)
    write_json(folder / "origin.json", read_json(before / "origin.json") | anew)


def _check_target(out: Path, results: Path) -> None:
    """Refuse a folder in whose place something would be lost."""
    place, kept = out.resolve(), results.resolve()
    if kept.is_relative_to(place):
        raise BadInput(f"{out}: contains the results {results}; choose another folder")
    if place.is_relative_to(kept) and (stage := place.relative_to(kept).parts[0]) in _KEPT:
        raise BadInput(f"{out}: lies in {results / stage}, part of the results; choose another one")
    if out.is_symlink() or (out.exists() and not out.is_dir()):
        raise BadInput(f"{out}: exists and is not a folder; choose another one")
    if not out.is_dir() or not any(out.iterdir()):
        return
    index = read_json(out / INDEX) if (out / INDEX).is_file() else None
    listed = index.get("files") if isinstance(index, dict) else None
    if not isinstance(listed, dict):
        raise BadInput(f"{out}: exists and holds no published run ({INDEX}); choose another folder")
    own = {INDEX, INDEX + SIDECAR_SUFFIX, *listed}
    there = {path.relative_to(out).as_posix() for path in out.rglob("*") if not path.is_dir()}
    if others := sorted(there - own):
        raise BadInput(f"{out}: also holds {others[0]}, which {INDEX} does not list; move it first")


def _check_file(path: Path) -> None:
    """Refuse a file that cannot be read, or is not what its record or its card describes."""
    check_recorded(path)
    if path.suffix == ".json":
        _mapping(path)
    elif path.suffix == ".parquet":
        read_parquet(path)
    elif path.suffix == ".safetensors":
        card = _mapping(path.with_suffix(".json"))
        if card.get("weights_sha256") != file_digest(path):
            raise Damaged(path, f"not the weights that its card {path.stem}.json describes")


def _unscored(results: Path, digests: Mapping[str, str]) -> list[str]:
    """Models that the scores do not include; BadInput if these are of what is not there.

    `digests` has the SHA-256 of every file that is published.
    """
    found: set[str] = set()
    for path in [results / "evaluate" / name for name in SCORES]:
        if not path.is_file():
            continue
        try:
            record = read_provenance(path)
        except FileNotFoundError:
            raise BadInput(f"{path}: has no record of what was evaluated; {_AGAIN}") from None
        others, unscored = compare(record, digests)
        if others:
            raise BadInput(f"{path}: scores of another {and_more(others)} than is there; {_AGAIN}")
        found.update(unscored)
    return sorted(found)


def _mapping(path: Path) -> dict[str, Any]:
    content = read_json(path)
    if not isinstance(content, dict) or not content:
        raise Damaged(path, "must be a mapping, and not empty")
    return content


def _describe_dataset(sample: Path, folder: Path) -> None:
    """Write the digests of a dataset's files, and of what they were made from."""
    rows, digest = read_manifest(sample)
    shards = {row["file"] for row in rows}
    dataset = {
        "digest": digest,
        "videos": len(rows),
        "images": sum(row["frames"] for row in rows),
        "files": {
            file: file_digest(sample / file) for file in sorted(shards) if (sample / file).is_file()
        },
    }
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / "digests.json", dataset)
    if lineage := _lineage(sample.resolve().parent, shards):
        write_json(folder / "lineage.json", lineage)


def _lineage(results: Path, shards: Iterable[str]) -> dict[str, dict[str, str]]:
    """Artefact -> path and SHA-256 of what it was made from, from the files of images back.

    Empty where a render has no record any more: half a chain leads nowhere.
    """
    waiting = [f"{results.name}/sample/{file}" for file in sorted(shards)]
    found: dict[str, dict[str, str]] = {}
    for name in waiting:  # grows
        if name not in found:
            # What comes from outside, or is no longer there, has no record.
            with contextlib.suppress(FileNotFoundError, BadInput, ValueError):
                found[name] = read_provenance(results.parent / name)["inputs"]
                waiting += found[name]
    rendered = {one for name in found if "/sample/" in name for one in found[name]}
    return found if rendered <= set(found) else {}


def _copy(source: Path, to: Path, missing: list[str]) -> None:
    """Copy a file and its record; say at the head of a page what the run lacks."""
    to.parent.mkdir(parents=True, exist_ok=True)
    record = source.with_name(source.name + SIDECAR_SUFFIX)
    if missing:
        text = source.read_text(encoding="utf-8")
        note = (
            '<p style="margin:0;padding:10px;background:#fff3cd;color:#000"><b>Partial.</b> This '
            f"run is not finished: {and_more(missing)} lacking.</p>"
        )
        page, count = re.subn(r"(<body[^>]*>)", rf"\1{note}", text, count=1)
        if not count:
            raise BadInput(f"{source}: no page: it has no body to mark as partial")
        to.write_text(page, encoding="utf-8")
    else:
        shutil.copyfile(source, to)
        if record.is_file():
            shutil.copyfile(record, to.with_name(record.name))


def _costs(results: Results) -> Iterator[dict[str, Any]]:
    """A row a class of jobs: of the rendering, light, images, previews and comparison apart."""
    for cost in results.benchmarks(job_classes=True):
        yield json.loads(json.dumps(asdict(cost)).replace("NaN", "null"))


def _simulations(results: Results) -> Iterator[dict[str, Any]]:
    """What each simulation cost and how well it is solved."""
    for one in results.simulated():
        run = read_trajectory(results.simulation_path(one))
        job = results.folder / "benchmarks" / "simulate" / f"{one.id}.tsv"
        cost = read_benchmark(job)
        settings = SimulationSettings.model_validate(run.metadata["settings"])
        # Not the trajectory's own record: a study may be newer than the simulations.
        known = measured_convergence(one.material, one.friction, settings)
        yield {
            "simulation": one.id,
            "material": one.material,
            "friction": one.friction,
            "cpu_s": cost and cost.cpu_s,
            "wall_s": cost and cost.wall_s,
            "memory_mib": cost and cost.memory_mib,
            "simulated_s": round(float(run.time_s[-1]), 3),
            "friction_tolerance": settings.friction_tolerance,
            "convergence": known and known["verdict"],
            **run.metadata.get("solver", {}),
        }
