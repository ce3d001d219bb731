"""Machine-readable descriptions of a release: Croissant, and an RO-Crate of every job behind it.

The crate follows Process, Workflow and Provenance Run Crate 0.5 and Workflow RO-Crate 1.0: the run
of the whole workflow is one ``CreateAction``, every job another, started for a step of the workflow
(``HowToStep``) by Snakemake (``ControlAction``). Files between the jobs are contextual entities.
Left out is what no record holds: when each job began, and parameters one by one.
"""

import datetime
import json
import mimetypes
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mlcroissant as mlc
import pyarrow as pa
import pyarrow.parquet as pq
from rocrate.model.contextentity import ContextEntity
from rocrate.model.file import File
from rocrate.rocrate import ROCrate

from slipstitch.base.errors import SlipstitchError
from slipstitch.base.provenance import file_digest
from slipstitch.dataset.manifest import MANIFEST
from slipstitch.dataset.release.checksums import files_below
from slipstitch.dataset.release.currency import CODE, SNAKEFILE
from slipstitch.dataset.release.manifest import described
from slipstitch.dataset.release.records import CRATE, RELEASE_RECORD, Artefact, record_file
from slipstitch.dataset.release.shards import FOLDER

VIDEOS, FRAMES = "videos", "frames"
_SHARDS = "shards"

_KINDS = {  # the others are texts
    pa.float64(): mlc.DataType.FLOAT,
    pa.int64(): mlc.DataType.INTEGER,
    pa.int32(): mlc.DataType.INTEGER,
    pa.bool_(): mlc.DataType.BOOL,
}


def _field(record_set: str, column: pa.Field, source: dict[str, str]) -> mlc.Field:
    is_image = pa.types.is_struct(column.type)  # as Hugging Face datasets lays it out
    kind = mlc.DataType.IMAGE_OBJECT if is_image else _KINDS.get(column.type, mlc.DataType.TEXT)
    transforms = [mlc.Transform(json_path="bytes")] if is_image else []
    extract = mlc.Extract(column=column.name)
    of_video = record_set == FRAMES and column.name == "video"
    more = {"references": mlc.Source(field=f"{VIDEOS}/video")} if of_video else {}
    return mlc.Field(
        id=f"{record_set}/{column.name}",
        name=column.name,
        description=described(column.name),
        data_types=[kind],
        source=mlc.Source(**source, extract=extract, transforms=transforms),
        **more,
    )


def croissant_text(folder: Path, facts: Mapping[str, Any]) -> str:
    """Text of ``croissant.json``, which mlcroissant has checked; SlipstitchError if it is wrong.

    It is of the release in `folder`, its manifest and shards in it.
    """
    manifest = folder / MANIFEST
    shards = sorted(folder.glob(f"{FOLDER}/*.parquet"))
    parquet = "application/x-parquet"
    distribution = [
        mlc.FileObject(
            id=MANIFEST,
            name=MANIFEST,
            description="One row per video: labels, splits, location and digest of its images",
            content_url=MANIFEST,
            content_size=f"{manifest.stat().st_size} B",
            encoding_formats=[parquet],
            sha256=file_digest(manifest),
        ),
        mlc.FileSet(
            id=_SHARDS,
            name=_SHARDS,
            description="Image shards, one row per image",
            encoding_formats=[parquet],
            includes=[f"{FOLDER}/*.parquet"],
        ),
    ]
    sets = [
        mlc.RecordSet(
            id=name,
            name=name,
            description=description,
            fields=[_field(name, column, source) for column in pq.read_schema(path)],
            **key,
        )
        for name, description, path, source, key in (
            (VIDEOS, "The videos", manifest, {"file_object": MANIFEST},
             {"key": [f"{VIDEOS}/video"]}),
            (FRAMES, "The images of the videos, in order", shards[0], {"file_set": _SHARDS}, {}),
        )
    ]  # fmt: skip
    try:
        metadata = mlc.Metadata(
            name=facts["name"],
            description=facts["description"],
            cite_as=facts["citation"],
            creators=[mlc.Organization(name="The Slipstitch developers")],
            date_published=datetime.datetime.fromisoformat(facts["date"]),
            keywords=list(facts["keywords"]),
            license=[facts["licence_url"]],
            version=facts["version"],
            distribution=distribution,
            record_sets=sets,
        )
    except mlc.ValidationError as error:
        raise SlipstitchError(f"Croissant metadata is not valid: {error}") from None
    return json.dumps(metadata.to_json(), indent=1, ensure_ascii=False, default=str) + "\n"


PROFILES = {
    "https://w3id.org/ro/wfrun/process/0.5": {"name": "Process Run Crate", "version": "0.5"},
    "https://w3id.org/ro/wfrun/workflow/0.5": {"name": "Workflow Run Crate", "version": "0.5"},
    "https://w3id.org/ro/wfrun/provenance/0.5": {"name": "Provenance Run Crate", "version": "0.5"},
    "https://w3id.org/workflowhub/workflow-ro-crate/1.0": {"name": "Workflow RO-Crate"},
}
_ENGINE = "https://snakemake.github.io"
_CONTEXT = "https://w3id.org/ro/terms/workflow-run/context"
_TYPES = {".parquet": "application/vnd.apache.parquet", ".cff": "text/yaml", ".smk": "text/plain"}


def _entity(crate: ROCrate, identity: str, kind: str, **properties: Any) -> ContextEntity:
    """Add something that is no file of the release."""
    return crate.add(ContextEntity(crate, identity, {"@type": kind, **properties}))


def _file(crate: ROCrate, folder: Path, name: str) -> File:
    guessed = _TYPES.get(Path(name).suffix) or mimetypes.guess_type(name)[0]
    properties = {
        "contentSize": str((folder / name).stat().st_size),
        "encodingFormat": guessed or "text/plain",
        "sha256": file_digest(folder / name),
    }
    return crate.add(File(crate, dest_path=name, properties=properties))


def crate_text(
    folder: Path,
    facts: Mapping[str, Any],
    artefacts: Mapping[str, Artefact],
    record: Mapping[str, Any],
) -> str:
    """Text of ``ro-crate-metadata.json``, over everything that was in `folder` before it."""
    crate = ROCrate(version="1.1")  # which the profiles are based on
    crate.metadata.extra_contexts.append(_CONTEXT)  # has sha256
    root = crate.root_dataset
    crate.name, crate.description = facts["title"], facts["description"]
    crate.license, crate.keywords = facts["licence_url"], list(facts["keywords"])
    root["version"] = facts["version"]
    root["datePublished"] = facts["date"]
    main = crate.add_workflow(
        dest_path=SNAKEFILE,
        main=True,
        lang="snakemake",
        properties={
            "@type": ["File", "SoftwareSourceCode", "ComputationalWorkflow", "HowTo"],
            "name": "Slipstitch workflow",
            "sha256": file_digest(folder / SNAKEFILE),
        },
    )
    root["conformsTo"] = [
        _entity(crate, url, "CreativeWork", **profile) for url, profile in PROFILES.items()
    ]
    entities: dict[str, Any] = {
        name: _file(crate, folder, name)
        for name in files_below(folder)
        if name not in (SNAKEFILE, CRATE, RELEASE_RECORD) and not name.startswith(f"{CODE}/src")
    }
    crate.add_dataset(dest_path=f"{CODE}/src", properties={"name": "Sources of slipstitch"})
    # Files between the jobs, which the records of the release describe.
    entities |= {
        path: _entity(
            crate, f"#{path}", "CreativeWork", name=path, sha256=artefact.sha256,
            subjectOf={"@id": record_file(path)},
        )
        for path, artefact in artefacts.items()
    }  # fmt: skip
    shards = [entity for name, entity in entities.items() if name.startswith(f"{FOLDER}/")]
    actions = [
        _action(crate, path, artefact.provenance, [entities[path]], entities)
        for path, artefact in artefacts.items()
        if artefact.provenance is not None
    ]
    actions.append(_action(crate, "release", record, shards, entities))
    whole = crate.add_action(
        main,
        "#run",
        object=[entities["records/config.json"]],
        result=[entities[MANIFEST], *shards],
        properties={"name": "The workflow run that generated this release"},
    )
    root["mentions"] = [whole, *actions, _organised(crate, main, whole, actions)]
    return json.dumps(crate.metadata.generate(), indent=1, ensure_ascii=False) + "\n"


def _organised(crate: ROCrate, main, whole, actions: list):
    """Snakemake's part: the workflow's steps, and each job as the execution of one."""
    main["hasPart"] = list(
        {action["instrument"].id: action["instrument"] for action in actions}.values()
    )
    steps: dict[str, ContextEntity] = {}
    for place, tool in enumerate(main["hasPart"], 1):
        steps[tool.id] = _entity(
            crate, f"{SNAKEFILE}#{tool.id.removeprefix('#')}", "HowToStep",
            name=tool["name"], position=str(place), workExample=tool,
        )  # fmt: skip
    main["step"] = list(steps.values())
    controls = [
        _entity(
            crate, action.id.replace("#job/", "#control/"), "ControlAction",
            name=f"start of {action.id.removeprefix('#job/')}",
            instrument=steps[action["instrument"].id], object=action,
        )
        for action in actions
    ]  # fmt: skip
    engine = _entity(crate, _ENGINE, "SoftwareApplication", name="Snakemake", url=_ENGINE)
    return _entity(
        crate, "#organize", "OrganizeAction",
        name="Run of Snakemake", instrument=engine, object=controls, result=whole,
    )  # fmt: skip


def _action(
    crate: ROCrate, name: str, record: Mapping[str, Any], result: list, entities: Mapping[str, Any]
):
    """The job that wrote a result, by its record."""
    return crate.add_action(
        _tool(crate, record),
        f"#job/{name}",
        object=[entities[path] for path in record["inputs"] if path in entities],
        result=result,
        properties={
            "name": f"slipstitch {record['stage']}",
            "actionStatus": "http://schema.org/CompletedActionStatus",
            "description": f"{record['wall_s']} s, {record['cpu_s']} CPU s; {record['host_kind']}",
        },
    )


def _tool(crate: ROCrate, record: Mapping[str, Any]):
    """The stage as software, one entity for each state of its code."""
    stage = record["stage"]
    identity = f"#stage/{stage}/{record['code_digest'][:12]}"
    return crate.get(identity) or _entity(
        crate, identity, "SoftwareApplication",
        name=f"slipstitch {stage}",
        softwareVersion=record["versions"]["slipstitch"],
        sha256=record["code_digest"],
        identifier=record["git_commit"] or "unknown commit",
    )  # fmt: skip
