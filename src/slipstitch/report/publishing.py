"""A run's results as a small folder to keep: scores, predictions, curves, costs, model, origin."""

import contextlib
import json
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pandas
import pyarrow.parquet as pq

from slipstitch.base import provenance
from slipstitch.base.errors import BadInput, Damaged
from slipstitch.base.provenance import file_digest, read_json, read_parquet, read_provenance
from slipstitch.base.provenance.files import SIDECAR_SUFFIX
from slipstitch.base.provenance.record import write_json
from slipstitch.config import Config, load_config
from slipstitch.config.simulation import SimulationSettings
from slipstitch.dataset.audit.published import FURTHER, INDEX, WEIGHTS
from slipstitch.dataset.manifest import MANIFEST, read_manifest
from slipstitch.design.trainable import keeps_networks_of_all_views, trainings
from slipstitch.film.measure import SHIPPED
from slipstitch.physics.simulation.convergence import measured_convergence
from slipstitch.physics.simulation.trajectory import read_trajectory
from slipstitch.report.cost import STAGES, Measured, benchmarks, read_benchmark
from slipstitch.report.results import Results

_AGAIN = "run slipstitch evaluate again, in the folder that contains the results"
# What the workflow keeps below the results beside its stages.
_KEPT = (*STAGES, "ablate", "captures", "benchmarks", "logs")
#: Beside what a finished run must have; there if the target `ablate` or `captures` was run.
OPTIONAL = ("ablate/ablate.json", "captures/metrics.json", "captures/predictions.parquet")
#: Files of an evaluation, each with the same record.
SCORES = ("metrics.json", "details.json", "predictions.parquet")
#: Before a model without scores, in the list of what a published run lacks.
SCORES_OF = "scores of "
_AVERAGE = ("instrument.safetensors", "instrument.json", "calibration.parquet", "readings.parquet")
# Made from all images and trajectories: of an update, whose results may have no longer all.
_OF_ALL = ("cost.json", "simulations.csv", "dataset/digests.json", "dataset/lineage.json")
_OWN = (*_OF_ALL, "config.json", "origin.json")


def finished_files(config: Config) -> dict[str, str]:
    """Files of a finished run, below its results -> where they are published."""
    files = {f"evaluate/{name}": name for name in SCORES}
    files["calibrate/calibration.json"] = "calibration.json"
    files[f"sample/{MANIFEST}"] = f"dataset/{MANIFEST}"
    of_instrument = ("instrument.safetensors", "instrument.json", "history.csv")
    of_network = ["model.safetensors", "model.json", "history.csv"]
    if keeps_networks_of_all_views(config.train):
        of_network += ["all_views/model.safetensors", "all_views/model.json"]
    for split in config.train.splits:
        for network, seed in trainings(config.train, split):
            folder = f"{split}/{network}/seed{seed}"
            files |= {f"train/{folder}/{file}": f"models/{folder}/{file}" for file in of_network}
        seeds = config.instrument.seeds
        names = [f"seed{seed}/{file}" for seed in seeds for file in of_instrument]
        names += [f"ensemble/{file}" for file in _AVERAGE if len(seeds) > 1]
        for name in names:
            files[f"instrument/{split}/{name}"] = f"models/{split}/instrument/{name}"
    return files


def _is_published(config: Config, to: str) -> bool:
    """Whether a file of a run is published itself: of weights those of the model that ships.

    That is the average of the instruments, or the only one.
    """
    ships = "ensemble" if len(config.instrument.seeds) > 1 else "instrument"
    return not to.endswith(WEIGHTS) or f"/{ships}/" in to


def publish(
    config: Config,
    results: str | os.PathLike,
    out: str | os.PathLike,
    partial: bool = False,
    update: bool = False,
) -> dict[str, Any]:
    """Write the folder, whole or not at all; return the content of ``published.json``.

    That is ``name``, ``partial``, ``missing`` and the SHA-256 of every file. BadInput if `out`
    holds anything else than an earlier run, if the run is not finished, without `partial`, if a
    file is damaged, or if the scores are of other models or another dataset. With `update`, `out`
    keeps what the results of the same dataset and configuration have no longer.
    """
    started = provenance.start_clock()
    found, out = Results(results, config), Path(out)
    _check_target(out, found.folder)
    kept = _kept(config, found, out) if update else {}
    there, missing = _gathered(config, found, kept)
    if not partial and missing:
        raise BadInput(
            f"{results}: not finished: {missing[0]} is missing ({len(missing)} of "
            f"{len(there) + len(missing)} files); --partial publishes what is there"
        )
    digests = kept | {to: file_digest(path) for to, path in there.items()}
    unscored = _unscored([there.get(name, out / name) for name in SCORES], digests)
    if unscored and not partial:
        lacking = f"the scores do not include {unscored[0]}"
        raise BadInput(f"{results}: {lacking}; {_AGAIN}, or publish with --partial")
    missing += [SCORES_OF + name for name in unscored]
    with provenance.atomic_path(out) as folder:
        record = provenance.provenance_record(
            "publish", inputs=there.values(), config=config, started=started
        )
        write_json(folder / "config.json", config.model_dump(mode="json"))
        costs = [cost._asdict() for cost in benchmarks(found.folder, job_classes=True)]
        write_json(folder / "cost.json", json.loads(json.dumps(costs).replace("NaN", "null")))
        if solved := list(_simulations(found)):
            pandas.DataFrame(solved).to_csv(folder / "simulations.csv", index=False)
        write_json(folder / "origin.json", dict(found.provenance()))
        for to, path in there.items():
            _copy(path, folder / to, _is_published(config, to))
            if path.name == MANIFEST:
                _describe_dataset(path.parent, (folder / to).parent)
        if update:
            _keep(config, out, folder, there, kept)
            record["inputs"] = read_provenance(out / INDEX)["inputs"] | record["inputs"]
        index = {
            "name": config.publish.name,
            "partial": bool(missing),
            "missing": missing,
            "files": {name: file_digest(folder / name) for name in _files(folder)},
        }
        write_json(folder / INDEX, index, record)
    return index


def _gathered(
    config: Config, results: Results, kept: Mapping[str, str]
) -> tuple[dict[str, Path], list[str]]:
    """What is published -> the file of the results; and what of a finished run is not there."""
    names = {to: name for name, to in finished_files(config).items()}
    wanted = {to: results.folder / name for to, name in names.items()}
    for number, dataset in enumerate(config.instrument.calibration_datasets):
        place = f"{FURTHER}{number}/{MANIFEST}"
        wanted[place] = results.folder.parent / dataset / MANIFEST
    optional = {name: results.folder / name for name in OPTIONAL}
    there = {to: path for to, path in (wanted | optional).items() if path.is_file()}
    if not kept and not set(there) - set(optional):
        raise BadInput(f"{results.folder}: nothing of a run in it")
    for path in there.values():
        _check_file(path)
    lacking = wanted.keys() - there.keys() - kept.keys()
    return there, sorted(names.get(to, to) for to in lacking)


def _kept(config: Config, results: Results, out: Path) -> dict[str, str]:
    """SHA-256 of what a folder published before keeps; of other weights as their card names it."""
    if not (out / INDEX).is_file():
        raise BadInput(f"{out}: nothing published there to update: publish without --update")
    published = load_config(out / "config.json")
    if _of_run(published) != _of_run(config):
        raise BadInput(f"{out}: published with another configuration; publish without --update")
    manifest = results.folder / "sample" / MANIFEST
    before = out / "dataset" / MANIFEST
    # Filmed again elsewhere, the images are the same in other files.
    digests = {read_manifest(one.parent)[1] for one in (manifest, before) if one.is_file()}
    if len(digests) > 1:
        raise BadInput(f"{out}: published of another dataset; publish without --update")
    # Scores of other captures are none of this configuration's.
    optional = [
        to for to in OPTIONAL if published.captures == config.captures or "captures" not in to
    ]
    kept = {}
    for to in (*finished_files(config).values(), *optional, *_OWN, *_files(out, FURTHER)):
        card = (out / to).with_suffix(".json")
        if (out / to).is_file():
            kept[to] = file_digest(out / to)
        elif to.endswith(WEIGHTS) and card.is_file():
            kept[to] = read_json(card)["weights_sha256"]
    return kept


def _files(out: Path, below: str = "") -> list[str]:
    """Files of a folder, or of one in it."""
    there = sorted((out / below).rglob("*"))
    return [path.relative_to(out).as_posix() for path in there if not path.is_dir()]


def _of_run(config: Config) -> dict[str, Any]:
    """The configuration but for calibration datasets and captures, which alter nothing else."""
    return config.model_dump(exclude={"captures": True, "instrument": {"calibration_datasets"}})


def _keep(
    config: Config, before: Path, folder: Path, there: Iterable[str], kept: Iterable[str]
) -> None:
    """Put into a new folder what the one before has of results that are gone."""
    known = {to: name for name, to in finished_files(config).items()}
    anew = {known.get(name) for name in there}
    for to in set(kept) - {*there, *_OWN}:
        for name in (to, to + SIDECAR_SUFFIX):
            if (before / name).is_file() and not (folder / name).exists():
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(before / name, folder / name)
    same = load_config(before / "config.json") == config
    manifests = [one / "dataset" / MANIFEST for one in (before, folder)]
    again = all(map(Path.is_file, manifests)) and len({*map(file_digest, manifests)}) > 1
    for name in (*_OF_ALL, *(["config.json"] if same else [])):
        # Filmed again, the images are in other files; those of the new manifest are described,
        # unless what they were made from is gone: that of the same images stays.
        anew_described = again and name.startswith("dataset/") and (folder / name).is_file()
        if (before / name).is_file() and not anew_described:
            shutil.copyfile(before / name, folder / name)
    # Records of what is there again, but not published anew, are not those of the published files.
    origin = {name: one for name, one in read_json(folder / "origin.json").items() if name in anew}
    write_json(folder / "origin.json", read_json(before / "origin.json") | origin)


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
    if others := sorted({*_files(out)} - own):
        raise BadInput(f"{out}: also holds {others[0]}, which {INDEX} does not list; move it first")


def _check_file(path: Path) -> None:
    """Refuse a file that cannot be read, or is not what its record or its card describes."""
    provenance.check_recorded(path)
    if path.suffix == ".parquet":
        read_parquet(path)
    elif path.suffix in (".json", WEIGHTS):
        card = path.with_suffix(".json")
        content = read_json(card)
        if not isinstance(content, dict) or not content:
            raise Damaged(card, "must be a mapping, and not empty")
        if path != card and content.get("weights_sha256") != file_digest(path):
            raise Damaged(path, f"not the weights that its card {card.name} describes")


def _unscored(scores: Iterable[Path], digests: Mapping[str, str]) -> list[str]:
    """Models that the scores do not include; BadInput if these are of what is not there."""
    ends = (WEIGHTS, MANIFEST)
    there = {name: one for name, one in digests.items() if name.endswith(ends)}
    # Scored beside the run's own models.
    shipped = [file_digest(path) for path in SHIPPED.glob(f"*{WEIGHTS}")]
    known = {*there.values(), *shipped}
    found: set[str] = set()
    for path in scores:
        if not path.is_file():
            continue
        try:
            inputs = (read_provenance(path).get("inputs") or {}).items()
        except FileNotFoundError:
            raise BadInput(f"{path}: has no record of what was evaluated; {_AGAIN}") from None
        evaluated = {name: one for name, one in inputs if name.endswith(ends)}
        others = sorted(name for name, one in evaluated.items() if one not in known)
        if others:
            raise BadInput(f"{path}: scores of another {others[0]} than is there; {_AGAIN}")
        found |= {name for name, one in there.items() if one not in evaluated.values()}
    # Datasets of other benches calibrate; the scores are of the run's own.
    return sorted(name for name in found if not name.startswith(FURTHER))


def _describe_dataset(sample: Path, folder: Path) -> None:
    """Write the digests of a dataset's files, and of what they were made from."""
    rows, digest = read_manifest(sample)
    shards = sorted({row["file"] for row in rows})
    dataset = {
        "digest": digest,
        "videos": len(rows),
        "images": sum(row["frames"] for row in rows),
        "files": {file: file_digest(sample / file) for file in shards if (sample / file).is_file()},
    }
    write_json(folder / "digests.json", dataset)
    if lineage := _lineage(sample.resolve().parent, shards):
        write_json(folder / "lineage.json", lineage)


def _lineage(results: Path, shards: Iterable[str]) -> dict[str, dict[str, str]]:
    """Artefact -> path and SHA-256 of what it was made from; empty if a render has no record."""
    waiting = [f"{results.name}/sample/{file}" for file in shards]
    found: dict[str, dict[str, str]] = {}
    for name in waiting:  # grows
        if name not in found:
            # What comes from outside, or is no longer there, has no record.
            with contextlib.suppress(FileNotFoundError, BadInput, ValueError):
                found[name] = read_provenance(results.parent / name)["inputs"]
                waiting += found[name]
    rendered = {one for name in found if "/sample/" in name for one in found[name]}
    return found if rendered <= set(found) else {}


def _copy(source: Path, to: Path, published: bool) -> None:
    """Copy a file, tables more compactly, and its record; of other weights the record alone."""
    if source.name == "calibration.json":
        write_json(to, _without_runs(read_json(source)))
        return
    to.parent.mkdir(parents=True, exist_ok=True)
    if source.suffix == ".parquet" and source.name != MANIFEST:
        pq.write_table(read_parquet(source), to, compression="zstd", use_dictionary=False)
    elif published:
        shutil.copyfile(source, to)
    record = source.with_name(source.name + SIDECAR_SUFFIX)
    # The record of a model's card and curve is that of its weights.
    if record.is_file() and (source.suffix == WEIGHTS or "models" not in to.parts):
        shutil.copyfile(record, to.with_name(record.name))


def _without_runs(content: Any) -> Any:
    """A structure without its entries ``runs``."""
    if isinstance(content, dict):
        return {key: _without_runs(one) for key, one in content.items() if key != "runs"}
    return [_without_runs(one) for one in content] if isinstance(content, list) else content


def _simulations(results: Results) -> Iterator[dict[str, Any]]:
    """What each simulation cost and how well it is solved."""
    for one in results.simulated():
        run = read_trajectory(results.simulation_path(one))
        cost = read_benchmark(results.folder / "benchmarks" / "simulate" / f"{one.id}.tsv")
        settings = SimulationSettings.model_validate(run.metadata["settings"])
        # Not the trajectory's own record: a study may be newer than the simulations.
        known = measured_convergence(one.material, one.friction, settings)
        yield {
            **{"simulation": one.id, "material": one.material, "friction": one.friction},
            **(cost._asdict() if cost else dict.fromkeys(Measured._fields)),
            "simulated_s": round(float(run.time_s[-1]), 3),
            "friction_tolerance": settings.friction_tolerance,
            "convergence": known and known["verdict"],
            **run.metadata.get("solver", {}),
        }
