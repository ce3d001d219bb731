"""A careful forger: after an edit, mends everything in a release that can be computed from it."""

import json
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from slipstitch.base.errors import SlipstitchError
from slipstitch.base.provenance import attach_metadata, file_digest
from slipstitch.dataset.audit.contents import read_contents
from slipstitch.dataset.manifest import MANIFEST_SCHEMA, dataset_digest
from slipstitch.dataset.release import card, crate, croissant
from slipstitch.dataset.release.checksums import files_below, write_sums
from slipstitch.dataset.release.description import card_of
from slipstitch.dataset.release.manifest import notes_of, sampled_rows
from slipstitch.dataset.release.previews import draw_previews
from slipstitch.dataset.release.records import CRATE, CROISSANT, RELEASE_RECORD


def chunk(kind: bytes, body: bytes) -> bytes:
    """A chunk of a PNG, with its checksum."""
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


class Forger:
    """Edits a copy of a release.

    Parameters
    ----------
    release : path
        With files that may be written.
    original : path
        The same, not forged.
    """

    def __init__(self, release: Path, original: Path):
        self.release, self.original = release, original

    def edit_json(self, name: str, edit: Callable[[Any], Any]) -> None:
        """Change a JSON file."""
        path = self.release / name
        content = json.loads(path.read_text())
        edit(content)
        path.write_text(json.dumps(content, indent=1))

    def edit_records(self, pattern: str, edit: Callable[[dict], Any]) -> None:
        """Change the records whose path fits."""
        for path in sorted((self.release / "records").rglob("*.record.json")):
            if path.relative_to(self.release / "records").match(pattern):
                self.edit_json(path.relative_to(self.release).as_posix(), edit)

    def replace_everywhere(self, old: str, new: str) -> None:
        """Put another text in the place of one that is there, in every record and configuration."""
        found = 0
        for path in sorted((self.release / "records").rglob("*.json")):
            text = path.read_text()
            found += text.count(old)
            path.write_text(text.replace(old, new))
        assert found > 1, old

    def edit_text(self, name: str, old: str, new: str) -> None:
        """Put another text in the place of one that is there once or more."""
        path = self.release / name
        text = path.read_text(encoding="utf-8")
        assert old in text
        path.write_text(text.replace(old, new), encoding="utf-8")

    def edit_table(self, name: str, edit: Callable[[pa.Table], pa.Table]) -> None:
        """Change a table; images stay uncompressed, as a release has them."""
        path = self.release / name
        table = edit(pq.read_table(path))
        labels = [column for column in table.column_names if column != "image"]
        compression = {**dict.fromkeys(labels, "ZSTD"), "image": "NONE"}
        shard = name.startswith("data/")
        pq.write_table(
            table,
            path,
            compression=compression if shard else "zstd",
            use_dictionary=labels if shard else True,
        )

    def edit_rows(self, name: str, edit: Callable[[list[dict]], Any]) -> None:
        """Change the rows of a table."""

        def again(table: pa.Table) -> pa.Table:
            rows = table.to_pylist()
            edit(rows)
            return pa.Table.from_pylist(rows, schema=table.schema)

        self.edit_table(name, again)

    def cover_up(self, *kept: str) -> None:
        """Mend digests, manifest, card, Croissant, crate and sums; not what is `kept`."""
        self._link()
        self._digest_rows()
        contents = read_contents(self.release)
        facts, record = contents.release["facts"], contents.release["provenance"]
        pictures = {}
        for path, (words, picture) in self._previews(contents.rows).items():
            pictures[path] = words
            if path not in kept:
                picture.save(self.release / path)
        texts = {
            card.CARD: lambda: card_of(
                self.release, facts, contents.config, contents.rows, contents.artefacts, pictures
            ),
            CROISSANT: lambda: croissant.croissant_text(self.release, facts),
            CRATE: lambda: crate.crate_text(self.release, facts, contents.artefacts, record),
        }
        for name, make in texts.items():
            if name not in kept:
                (self.release / name).write_text(make(), encoding="utf-8")
        self.reseal()

    def _previews(self, rows: list[dict]) -> dict:
        try:
            return draw_previews(self.release, rows)
        except SlipstitchError:  # of images that cannot be drawn the old ones stay
            return draw_previews(self.original, rows)

    def reseal(self) -> None:
        """Write both lists of digests anew."""
        names = [name for name in files_below(self.release) if name != RELEASE_RECORD]
        digests = {name: file_digest(self.release / name) for name in names}
        self.edit_json(RELEASE_RECORD, lambda content: content.update(files=digests))
        write_sums(self.release)

    def _link(self) -> None:
        """Give every record the digests of the carried files as they are now."""
        now = {
            f"results/{path.relative_to(self.release / 'records').as_posix()}": file_digest(path)
            for path in (self.release / "records").rglob("*.json")
            if not path.name.endswith(".record.json")
        }

        def mend(record: dict) -> None:
            record["sha256"] = now.get(record["path"], record["sha256"])
            inputs = (record.get("provenance") or {}).get("inputs", {})
            inputs.update({name: now[name] for name in inputs if name in now})

        self.edit_records("*", mend)

    def _digest_rows(self) -> None:
        """Give manifest and sampling record the digests of the rows as they are now."""
        path = self.release / "manifest.parquet"
        table = pq.read_table(path)
        rows = table.to_pylist()
        splits = [name[6:] for name in table.column_names if name.startswith("split_")]
        notes = notes_of(rows, MANIFEST_SCHEMA, splits)
        pq.write_table(attach_metadata(table, notes), path, compression="zstd")
        try:
            digest = dataset_digest(sampled_rows(rows, MANIFEST_SCHEMA.names))
        except (KeyError, SlipstitchError):
            return
        self.edit_records(
            "sample/manifest.parquet.record.json",
            lambda record: record["metadata"].update(dataset_digest=digest),
        )
