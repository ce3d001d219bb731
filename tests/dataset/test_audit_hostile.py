"""A folder that somebody made to do harm: refused or found at once, in little memory."""

import json
import os
import shutil
import socket
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from support.forger import Forger

from slipstitch.dataset.images import DATASET_SCHEMA
from slipstitch.dataset.release.checksums import SUMS

pytestmark = pytest.mark.slow

# Importing the libraries takes most of both.
# Of a quiet machine 2 s are wanted; beyond 20 it hangs, however busy the machine is.
CPU_S, RSS_BYTES = 20.0, 2**30


@pytest.fixture
def forger(signed, tmp_path):
    return Forger(signed[0], tmp_path / "release")


@pytest.fixture
def release(forger):
    return forger.release


LAUNCHER = """
import json, os, subprocess, sys
command = [sys.executable, "-m", "slipstitch", "audit", sys.argv[1], "--jobs", "2"]
process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
said = process.stdout.read()
_, status, usage = os.wait4(process.pid, 0)
cpu_s = usage.ru_utime + usage.ru_stime
print(json.dumps([os.waitstatus_to_exitcode(status), said, cpu_s, 1024 * usage.ru_maxrss]))
"""


def audited(release: Path) -> tuple[int, str, float, int]:
    """Exit code, what was said, CPU seconds and largest resident size of an audit.

    By way of a small process: what this one has grown to would count as its child's.
    """
    command = [sys.executable, "-c", LAUNCHER, str(release)]
    answer = subprocess.run(command, capture_output=True, text=True, check=True)
    return tuple(json.loads(answer.stdout))


def chunk(kind: bytes, body: bytes) -> bytes:
    """A chunk of a PNG, with its checksum."""
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def shard_of(release: Path) -> Path:
    return min((release / "data").iterdir())


def instead(path: Path) -> Path:
    path.unlink()
    return path


def link_to_a_device(release):
    instead(shard_of(release)).symlink_to("/dev/zero")


def link_to_a_folder(release):
    instead(shard_of(release)).symlink_to("/usr")


def link_in_place_of_the_records(release):
    shutil.move(release / "records", release.parent / "records")
    (release / "records").symlink_to(release.parent / "records")


def link_to_itself(release):
    (release / "data/loop").symlink_to(".")


def pipe(release):
    os.mkfifo(instead(shard_of(release)))


def pipe_among_the_sources(release):
    os.mkfifo(release / "code/src/slipstitch/more.py")


def pipe_for_sums(release):
    os.mkfifo(instead(release / SUMS))


def a_socket(release):
    place = os.getcwd()
    os.chdir(release)  # the name of a socket is short
    try:
        with socket.socket(socket.AF_UNIX) as server:
            server.bind("socket")
    finally:
        os.chdir(place)


def hole(release):
    with open(release / "README.md", "r+b") as stream:
        stream.truncate(2**40)


def hole_in_a_shard(release):
    with open(shard_of(release), "r+b") as stream:
        stream.truncate(2**40)


def unprintable_name(release):
    (release / "data/\x1b[2Jintact").touch()


def deep_folders(release):
    (release / "/".join("d" * 60)).mkdir(parents=True)


DEEP = "[" * 100_000 + "]" * 100_000


def deep_record(release):
    next((release / "records/simulate").iterdir()).write_text(DEEP)


def deep_configuration(release):
    (release / "records/config.json").write_text(DEEP)


def deep_metadata(release):
    path = release / "manifest.parquet"
    table = pq.read_table(path).replace_schema_metadata({"slipstitch": DEEP})
    pq.write_table(table, path)


def _rows(image: bytes, count: int, **labels) -> pa.Table:
    row = {"video": "v", "position": 0, "image": {"bytes": image, "path": "p"}, **labels}
    one = pa.Table.from_pylist([row], schema=DATASET_SCHEMA)
    return one.take(pa.array(np.zeros(count, np.int64)))


def repeated_images(release):
    """1 GB of images, each the same 4 MB, as one entry of a dictionary."""
    table = _rows(bytes(2**22), 1)
    with pq.ParquetWriter(shard_of(release), table.schema, compression="zstd") as writer:
        for _ in range(250):
            writer.write_table(table)


def coded_images(release):
    pq.write_table(_rows(bytes(2**20), 400), shard_of(release), compression="zstd")


def repeated_text(release):
    table = _rows(b"", 1000, material="m" * 2**20)
    labels = [name for name in table.column_names if name != "image"]
    how = {**dict.fromkeys(labels, "ZSTD"), "image": "NONE"}
    pq.write_table(table, shard_of(release), compression=how, use_dictionary=labels)


def lying_footer(release):
    """A column of 1.2 GB in pages of zeros, of which the footer says that it has a few bytes."""
    table = _rows(b"", 1200, material="m" * 2**20)
    path = shard_of(release)
    labels = [name for name in table.column_names if name != "image"]
    how = {**dict.fromkeys(labels, "ZSTD"), "image": "NONE"}
    pq.write_table(
        table, path, compression=how, use_dictionary=False, data_page_size=2**31 - 1,
        write_statistics=False,
    )  # fmt: skip
    footer = pq.read_metadata(path)
    column = footer.row_group(0).column(table.column_names.index("material"))
    data = path.read_bytes()
    for size in (column.total_uncompressed_size, footer.row_group(0).total_byte_size):
        assert data.count(varint(size)) >= 1
        data = data.replace(varint(size), varint(100, len(varint(size))))
    path.write_bytes(data)


def varint(number: int, length: int = 0) -> bytes:
    """A number as Thrift's compact protocol writes it, padded to a length."""
    number, found = 2 * number, []
    while number or not found or len(found) < length:
        found.append(number & 0x7F)
        number >>= 7
    return bytes([*(byte | 0x80 for byte in found[:-1]), found[-1]])


def repeated_manifest(release):
    path = release / "manifest.parquet"
    table = pq.read_table(path)
    table = table.take(pa.array(np.zeros(200_000, np.int64)))
    pq.write_table(table, path, compression="zstd")


def long_text_in_the_manifest(release):
    path = release / "manifest.parquet"
    rows = pq.read_table(path).to_pylist()
    table = pa.Table.from_pylist(
        [row | {"material": "m" * 2**20} for row in rows], schema=pq.read_schema(path)
    )
    pq.write_table(table, path, compression="zstd")


def many_long_texts_in_the_manifest(release):
    """Another one in every row: together 1 MiB a row, packed to a few kB."""
    path = release / "manifest.parquet"
    rows = pq.read_table(path).to_pylist()
    for number, row in enumerate(rows):
        row["material"] = f"{number}" + "m" * 2**20
    table = pa.Table.from_pylist(rows, schema=pq.read_schema(path))
    pq.write_table(table, path, compression="zstd")


def huge_image(forger):
    header = (60_000).to_bytes(4, "big") * 2 + bytes([8, 2, 0, 0, 0])
    body = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(bytes(2**20)))
    image = b"\x89PNG\r\n\x1a\n" + body + chunk(b"IEND", b"")
    forger.edit_rows(
        f"data/{shard_of(forger.release).name}", lambda rows: rows[0]["image"].update(bytes=image)
    )


def growing_image(forger):
    header = (16).to_bytes(4, "big") * 2 + bytes([8, 2, 0, 0, 0])
    body = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(bytes(2**30)))
    image = b"\x89PNG\r\n\x1a\n" + body + chunk(b"IEND", b"")
    forger.edit_rows(
        f"data/{shard_of(forger.release).name}", lambda rows: rows[0]["image"].update(bytes=image)
    )


def deep_source(forger):
    (forger.release / "code/src/slipstitch/design/grid.py").write_text("x = " + "-" * 100_000 + "1")


def source_that_is_none(forger):
    (forger.release / "code/src/slipstitch/design/grid.py").write_bytes(b"\0\xff")


def records_in_a_circle(forger):
    forger.edit_records(
        "*",
        lambda one: (
            (one["provenance"] or {})
            .get("inputs", {})
            .update({"results/sample/manifest.parquet": "0" * 64})
        ),
    )


def records_of_other_kinds(forger):
    for key, value in {"inputs": {"a": 1}, "versions": [1], "git_commit": 3, "seed": {}}.items():
        forger.edit_records(
            "render/*", lambda one, key=key, value=value: one["provenance"].update({key: value})
        )
    forger.edit_records("simulate/*", lambda one: one["metadata"].update(solver=None, pinned="x"))
    forger.edit_records("sample/*", lambda one: one.update(metadata={"viewpoint": 1}))


REFUSED = {
    link_to_a_device: "is a link; a release contains only regular files",
    link_to_a_folder: "is a link",
    link_in_place_of_the_records: "records is a link",
    link_to_itself: "is a link",
    pipe: "is a pipe",
    pipe_among_the_sources: "is a pipe",
    pipe_for_sums: "is a pipe",
    a_socket: "is a socket",
    hole: "mostly a hole",
    hole_in_a_shard: "mostly a hole",
    unprintable_name: "not printable",
    deep_folders: "nested more than",
    deep_record: "nested more than",
    deep_configuration: "nested more than",
    deep_metadata: "nested too deeply",
    repeated_images: "compressed or coded again",
    coded_images: "compressed or coded again",
    repeated_text: "a text of 1048576 bytes",
    lying_footer: "takes far more memory than it has bytes",
    repeated_manifest: "rows compressed to",
    long_text_in_the_manifest: "a text of 1048576 bytes",
    many_long_texts_in_the_manifest: "bytes compressed to",
}
PACKED = (
    *(deep_metadata, repeated_images, coded_images, repeated_text, lying_footer),
    *(repeated_manifest, long_text_in_the_manifest, many_long_texts_in_the_manifest),
)
FOUND = {
    huge_image: "an image of more than",
    growing_image: "do not match the manifest",
    deep_source: "its code digest is not that of",
    source_that_is_none: "its code digest is not that of",
    records_in_a_circle: "broken chain",
    records_of_other_kinds: "broken chain",
}


@pytest.mark.parametrize("harm", REFUSED, ids=lambda harm: harm.__name__)
def test_hostile_folder_is_refused_in_one_line(forger, release, harm):
    harm(release)
    if harm in PACKED:
        forger.reseal()
    code, said, cpu_s, rss = audited(release)
    assert REFUSED[harm] in said
    assert (code, said.count("\n")) == (2, 1), said
    assert cpu_s < CPU_S
    assert rss < RSS_BYTES


@pytest.mark.parametrize("harm", FOUND, ids=lambda harm: harm.__name__)
def test_hostile_content_is_found(forger, harm):
    harm(forger)
    forger.reseal()
    code, said, _, rss = audited(forger.release)
    assert code == 1, said
    assert FOUND[harm] in said
    assert "Traceback" not in said
    assert rss < RSS_BYTES


def test_terminal_gets_no_control_characters(forger):
    forger.edit_json(
        "records/release.json", lambda one: one["facts"].update(name="\x1b[2Jall intact\n")
    )
    forger.reseal()
    said = audited(forger.release)[1]
    assert "\x1b" not in said
    assert not any(line.startswith("all intact") for line in said.splitlines())


def test_json_in_the_test_is_deep_enough():
    with pytest.raises(RecursionError):
        json.loads(DEEP)
