"""What a results folder holds, as digests free of when, where and how fast it was made.

Records of provenance, logs and benchmarks are left out; of Parquet files the rows count, of images
and films the pixels, of JSON everything but times. A file that cannot be read raises.
"""

import hashlib
import io
import json
import os
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from PIL import Image

LEFT_OUT = ("logs", "benchmarks", "status", "config.json")
# Keys of JSON objects that say how long something took or what made it.
OF_THIS_RUN = {"cpu_s", "wall_s", "provenance", "seconds", "made", "train_s", "trajectory_sha256"}
# They show times: that they are whole is all that can be asked.
SHOWS_TIMES = {"calibrate/settings.png"}


def _json(value):
    if isinstance(value, dict):
        return {key: _json(item) for key, item in value.items() if key not in OF_THIS_RUN}
    return [_json(item) for item in value] if isinstance(value, list) else value


def _pixels(data: bytes) -> bytes:
    with Image.open(io.BytesIO(data)) as image:
        return np.asarray(image.convert("RGBA")).tobytes()


def _film(path: Path) -> bytes:
    film, digest, frames = cv2.VideoCapture(str(path)), hashlib.sha256(), 0
    while (frame := film.read()[1]) is not None:
        digest.update(frame.tobytes())
        frames += 1
    assert frames > 1, path
    return digest.digest()


def _table(path: Path) -> bytes:
    table = pq.read_table(path)
    notes = json.loads((table.schema.metadata or {}).get(b"slipstitch", b"{}"))
    if "image" in table.column_names:
        images = [_pixels(row["bytes"]) for row in table["image"].to_pylist()]
        digests = pa.array([hashlib.sha256(image).digest() for image in images], pa.binary())
        table = table.set_column(table.column_names.index("image"), "image", digests)
    sink = pa.BufferOutputStream()
    table = table.replace_schema_metadata(None).combine_chunks()
    with pa.ipc.new_stream(sink, table.schema) as stream:
        stream.write_table(table)
    return json.dumps(_json(notes), sort_keys=True).encode() + sink.getvalue().to_pybytes()


def _content(path: Path, name: str) -> bytes:
    if name == "report/index.html":
        text = path.read_text(encoding="utf-8")
        assert text.rstrip().endswith("</html>"), path
        return b"whole"
    if path.suffix == ".png":
        pixels = _pixels(path.read_bytes())
        return b"whole" if name in SHOWS_TIMES else pixels
    if path.suffix == ".mp4":
        return _film(path)
    if path.suffix == ".parquet":
        return _table(path)
    if path.suffix in (".json", ".jsonl"):
        return json.dumps(_json(json.loads(path.read_text(encoding="utf-8")))).encode()
    return path.read_bytes()


def _artefacts(folder: Path) -> list[Path]:
    # A job may go on writing meanwhile: temporary folders are not entered, as they may vanish.
    found = []
    for place, folders, files in os.walk(folder):
        folders[:] = [name for name in folders if not name.endswith(".tmp")]
        found += [Path(place, name) for name in files if not name.endswith(".tmp")]
    return sorted(found)


def digests(results: Path) -> dict[str, str]:
    """SHA-256 of every artefact's content, by its path below the results folder.

    What lies under a temporary name is no artefact; see `leftovers`.

    A release counts with its data and splits; its records, card and checksums carry times, and so
    does what an audit says of them.
    """
    found = {}
    for path in _artefacts(results):
        name = path.relative_to(results).as_posix()
        if name.startswith(LEFT_OUT) or name.endswith(".provenance.json"):
            continue
        if name.startswith("release/") and not name.startswith(("release/data/", "release/splits")):
            found[name] = "of the release"
        elif name.startswith("audit/"):
            found[name] = _audited(path)
        else:
            found[name] = hashlib.sha256(_content(path, name)).hexdigest()
    return found


def _audited(path: Path) -> str:
    text = path.read_text(encoding="utf-8")
    return json.loads(text)["verdict"] if path.suffix == ".json" else str("intact" in text)


def leftovers(results: Path) -> list[str]:
    """Temporary files and folders that a writer left behind."""
    names = (path.relative_to(results).as_posix() for path in results.rglob("*.tmp"))
    return sorted(name for name in names if not name.startswith("logs"))
