"""Edits of a copy of a release, and new lists of digests over them."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from slipstitch.base.provenance import file_digest
from slipstitch.dataset.release.checksums import files_below, write_sums
from slipstitch.dataset.release.records import RELEASE_RECORD


class Forger:
    """Edits a copy of a release, made at `release` with files that may be written."""

    def __init__(self, original: Path, release: Path):
        self.release = Path(shutil.copytree(original, release))
        for path in release.rglob("*"):
            path.chmod(path.stat().st_mode | 0o200)

    def edit_json(self, name: str, edit: Callable[[Any], Any]) -> None:
        """Change a JSON file."""
        path = self.release / name
        content = json.loads(path.read_text())
        edit(content)
        path.write_text(json.dumps(content, indent=1))

    def edit_records(self, pattern: str, edit: Callable[[dict], Any]) -> list[str]:
        """Change the records whose path fits; return where they are."""
        records = sorted((self.release / "records").rglob("*.record.json"))
        found = [
            path.relative_to(self.release).as_posix()
            for path in records
            if path.match(f"{pattern}.record.json")
        ]
        for name in found:
            self.edit_json(name, edit)
        return found

    def edit_rows(self, name: str, edit: Callable[[list[dict]], Any]) -> None:
        """Change the rows of a table; images stay uncompressed, as a release has them."""
        path = self.release / name
        table = pq.read_table(path)
        rows = table.to_pylist()
        edit(rows)
        labels = [column for column in table.column_names if column != "image"]
        stored = {"compression": "zstd"}
        if "image" in table.column_names:
            compression = {**dict.fromkeys(labels, "ZSTD"), "image": "NONE"}
            stored = {"compression": compression, "use_dictionary": labels}
        pq.write_table(pa.Table.from_pylist(rows, schema=table.schema), path, **stored)

    def relabel(self, clip: str, **labels) -> None:
        """Change the row of a clip in the manifest."""

        def edit(rows):
            next(row for row in rows if row["video"] == clip).update(labels)

        self.edit_rows("manifest.parquet", edit)

    def reseal(self) -> None:
        """Write both lists of digests anew."""
        names = [name for name in files_below(self.release) if name != RELEASE_RECORD]
        digests = {name: file_digest(self.release / name) for name in names}
        self.edit_json(RELEASE_RECORD, lambda content: content.update(files=digests))
        write_sums(self.release)
