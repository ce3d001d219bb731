"""Croissant metadata: machine-readable description of the files of a release."""

import datetime
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mlcroissant as mlc
import pyarrow as pa
import pyarrow.parquet as pq

from slipstitch.base.errors import SlipstitchError
from slipstitch.base.provenance import file_digest
from slipstitch.dataset.release.manifest import MANIFEST, described
from slipstitch.dataset.release.shards import FOLDER

VIDEOS, FRAMES = "videos", "frames"
_SHARDS = "shards"

_KINDS = {
    pa.string(): mlc.DataType.TEXT,
    pa.float64(): mlc.DataType.FLOAT,
    pa.float32(): mlc.DataType.FLOAT,
    pa.int64(): mlc.DataType.INTEGER,
    pa.int32(): mlc.DataType.INTEGER,
    pa.bool_(): mlc.DataType.BOOL,
}


def _field(record_set: str, column: pa.Field, source: dict[str, str]) -> mlc.Field:
    extract = mlc.Extract(column=column.name)
    transforms = []
    kind = _KINDS.get(column.type, mlc.DataType.TEXT)
    if pa.types.is_struct(column.type):  # an image as Hugging Face datasets lays it out
        transforms = [mlc.Transform(json_path="bytes")]
        kind = mlc.DataType.IMAGE_OBJECT
    references = None
    if record_set == FRAMES and column.name == "video":
        references = mlc.Source(field=f"{VIDEOS}/video")
    return mlc.Field(
        id=f"{record_set}/{column.name}",
        name=column.name,
        description=described(column.name),
        data_types=[kind],
        source=mlc.Source(**source, extract=extract, transforms=transforms),
        **({"references": references} if references else {}),
    )


def croissant(folder: Path, facts: Mapping[str, Any]) -> mlc.Metadata:
    """The metadata of the release in `folder`, its manifest and shards in it.

    Parameters
    ----------
    folder : path
    facts : mapping
        ``name, version, title, description, licence_url, citation, date, keywords``.
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
            id=VIDEOS,
            name=VIDEOS,
            description="The videos",
            key=[f"{VIDEOS}/video"],
            fields=[
                _field(VIDEOS, column, {"file_object": MANIFEST})
                for column in pq.read_schema(manifest)
            ],
        ),
        mlc.RecordSet(
            id=FRAMES,
            name=FRAMES,
            description="The images of the videos, in order",
            fields=[
                _field(FRAMES, column, {"file_set": _SHARDS})
                for column in pq.read_schema(shards[0])
            ],
        ),
    ]
    return mlc.Metadata(
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


def croissant_text(folder: Path, facts: Mapping[str, Any]) -> str:
    """Text of ``croissant.json``; mlcroissant has checked it against the specification then.

    Raises
    ------
    SlipstitchError
        If it finds an error.
    """
    try:
        content = croissant(folder, facts).to_json()
    except mlc.ValidationError as error:
        raise SlipstitchError(f"Croissant metadata is not valid: {error}") from None
    return json.dumps(content, indent=1, ensure_ascii=False, default=str) + "\n"
