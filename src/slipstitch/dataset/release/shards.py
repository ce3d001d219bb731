"""Image shards of a release: Parquet, one row per image, one part of the splits per shard."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import read_parquet

FOLDER = "data"
HUGGING_FACE = b"huggingface"


class PartWriter:
    """Writes the shards of one part; a new one begins when `shard_bytes` are passed."""

    def __init__(self, folder: Path, part: str, schema: pa.Schema, shard_bytes: float):
        self.folder, self.part, self.schema = folder, part, schema
        self.shard_bytes = shard_bytes
        self.rows: list[int] = []
        self._writer: pq.ParquetWriter | None = None
        self._bytes = 0

    def _path(self, number: int) -> Path:
        return self.folder / f"{self.part}-{number:05d}.parquet"

    def write(self, table: pa.Table) -> tuple[int, int]:
        """Append rows that must stay together; return (number of the shard, first row in it)."""
        if self._writer is None:
            # PNG does not compress any further, the labels do.
            labels = [name for name in self.schema.names if name != "image"]
            self._writer = pq.ParquetWriter(
                self._path(len(self.rows)),
                self.schema,
                compression={**dict.fromkeys(labels, "ZSTD"), "image": "NONE"},
                use_dictionary=labels,
            )
            self.rows.append(0)
            self._bytes = 0
        place = len(self.rows) - 1, self.rows[-1]
        self._writer.write_table(table)
        self.rows[-1] += table.num_rows
        self._bytes += table.nbytes
        if self._bytes >= self.shard_bytes:
            self.close()
        return place

    def close(self) -> None:
        """Finish the shard that is being written."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None

    def finish(self) -> list[str]:
        """Name the shards ``<part>-00000-of-0000N.parquet``; return their paths in the release."""
        self.close()
        names = []
        for number in range(len(self.rows)):
            name = f"{self.part}-{number:05d}-of-{len(self.rows):05d}.parquet"
            self._path(number).rename(self.folder / name)
            names.append(f"{FOLDER}/{name}")
        return names


def shard_schema(schema: pa.Schema) -> pa.Schema:
    """The sample stage's schema with the Hugging Face features and nothing that a run leaves."""
    features = (schema.metadata or {}).get(HUGGING_FACE)
    return schema.with_metadata({HUGGING_FACE: features} if features else None)


def features_of(schema: pa.Schema) -> dict[str, Any]:
    """Hugging Face features of a shard, empty if it names none."""
    text = (schema.metadata or {}).get(HUGGING_FACE)
    return json.loads(text)["info"]["features"] if text else {}


def write_shards(
    sample_dir: Path,
    rows: Sequence[Mapping[str, Any]],
    part_of: Mapping[str, str],
    out: Path,
    shard_mb: float,
    progress=iter,
) -> dict[str, dict[str, Any]]:
    """Write all images, part by part.

    Parameters
    ----------
    sample_dir : path
        Folder of the sample stage.
    rows : sequence of mappings
        Its manifest: ``video``, ``file``, ``frames``.
    part_of : mapping
        Video -> part.
    out : path
        The release; shards go to ``data/`` in it.
    shard_mb : float
    progress : callable
        Wraps the list of files.

    Returns
    -------
    dict
        Video -> ``shard`` (path in the release) and ``first_row`` in it.

    Raises
    ------
    BadInput
        If a video is not where the manifest says.
    """
    folder = out / FOLDER
    folder.mkdir()
    files = list(dict.fromkeys(row["file"] for row in rows))
    schema = shard_schema(pq.read_schema(sample_dir / files[0]))
    writers = {
        part: PartWriter(folder, part, schema, shard_mb * 1e6)
        for part in sorted(set(part_of.values()))
    }
    frames = {row["video"]: row["frames"] for row in rows}
    videos_of: dict[str, list[str]] = {file: [] for file in files}
    for row in rows:
        videos_of[row["file"]].append(row["video"])
    places: dict[str, tuple[str, int, int]] = {}
    try:
        for file in progress(files):
            table = read_parquet(sample_dir / file)
            if shard_schema(table.schema) != schema:
                raise BadInput(f"{sample_dir / file}: columns differ from {files[0]}")
            table = table.replace_schema_metadata(schema.metadata)
            starts = _starts(table, sample_dir / file)
            for part in sorted({part_of[video] for video in videos_of[file]}):
                videos = [video for video in videos_of[file] if part_of[video] == part]
                for video in videos:
                    if starts.get(video, (0, 0))[1] != frames[video]:
                        raise BadInput(
                            f"{sample_dir / file}: not the {frames[video]} rows of {video} that "
                            "the manifest has"
                        )
                together = pa.concat_tables(table.slice(*starts[video]) for video in videos)
                number, first = writers[part].write(together.combine_chunks())
                for video in videos:
                    places[video] = (part, number, first)
                    first += frames[video]
    finally:
        for writer in writers.values():
            writer.close()
    names = {part: writer.finish() for part, writer in writers.items()}
    return {
        video: {"shard": names[part][number], "first_row": first}
        for video, (part, number, first) in places.items()
    }


def _starts(table: pa.Table, where: Path) -> dict[str, tuple[int, int]]:
    """Video -> (first row, rows); each video's rows follow each other."""
    runs = pc.run_end_encode(table["video"].combine_chunks())
    ends = runs.run_ends.to_pylist()
    found: dict[str, tuple[int, int]] = {}
    start = 0
    for video, end in zip(runs.values.to_pylist(), ends, strict=True):
        if video in found:
            raise BadInput(f"{where}: the rows of {video} are not consecutive")
        found[video] = (start, end - start)
        start = end
    return found
