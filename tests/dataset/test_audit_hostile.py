"""A folder that somebody made to do harm: refused or found at once, in little memory."""

import contextlib
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

from slipstitch.dataset.release.checksums import SUMS
from slipstitch.dataset.videos import DATASET_SCHEMA

pytestmark = pytest.mark.slow

# Importing the libraries takes most of both. 2 s are usual; beyond 20 it hangs.
CPU_S, RSS_BYTES = 20.0, 2**30


@pytest.fixture
def forger(signed, tmp_path):
    return Forger(signed[0], tmp_path / "release")


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


def linked(target):
    """Puts a link in the place of a shard."""
    return lambda release: instead(shard_of(release)).symlink_to(target)


def link_to_the_records(release):
    shutil.move(release / "records", release.parent / "records")
    (release / "records").symlink_to(release.parent / "records")


def a_socket(release):
    with contextlib.chdir(release), socket.socket(socket.AF_UNIX) as server:
        server.bind("socket")  # the name of a socket is short


def with_a_hole(path):
    os.truncate(path, 2**40)


LONG = "m" * 2**20
DEEP, NESTED = "[" * 100_000 + "]" * 100_000, "nested more than"


def deep_in(path):
    path.write_text(DEEP)


#: What is done to a release -> what is said of it.
REFUSED = {
    "a link to a device": (linked("/dev/zero"), "is a link; a release contains only regular files"),
    "a link to a folder": (linked("/usr"), "is a link"),
    "a link in place of the records": (link_to_the_records, "records is a link"),
    "a link to itself": (lambda one: (one / "data/loop").symlink_to("."), "is a link"),
    "a pipe": (lambda one: os.mkfifo(instead(shard_of(one))), "is a pipe"),
    "a pipe among the sources": (lambda one: os.mkfifo(one / "code/src/a.py"), "is a pipe"),
    "a pipe for sums": (lambda one: os.mkfifo(instead(one / SUMS)), "is a pipe"),
    "a socket": (a_socket, "is a socket"),
    "a hole": (lambda one: with_a_hole(one / "README.md"), "mostly a hole"),
    "a hole in a shard": (lambda one: with_a_hole(shard_of(one)), "mostly a hole"),
    "an unprintable name": (lambda one: (one / "data/\x1b[2Jintact").touch(), "not printable"),
    "deep folders": (lambda one: (one / "/".join("d" * 60)).mkdir(parents=True), "nested more"),
    "a deep record": (lambda one: deep_in(min((one / "records/simulate").iterdir())), NESTED),
    "a deep configuration": (lambda one: deep_in(one / "records/config.json"), NESTED),
}


def edited_manifest(change):
    """A function that rewrites a release's manifest, a table, as `change` makes it."""

    def edit(release):
        path = release / "manifest.parquet"
        pq.write_table(change(pq.read_table(path)), path, compression="zstd")

    return edit


def with_materials(name):
    """A function that gives the rows of a manifest other fabrics, by their numbers."""
    materials = lambda table: pa.array([name(k) for k in range(len(table))])  # noqa: E731
    return edited_manifest(
        lambda one: one.set_column(one.column_names.index("material"), "material", materials(one))
    )


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


def text_in_a_shard(release, rows, dictionary=True, **options):
    """The same text of 1 MiB in every row; images uncompressed, as a shard has them."""
    table = _rows(b"", rows, material=LONG)
    labels = [name for name in table.column_names if name != "image"]
    how = {**dict.fromkeys(labels, "ZSTD"), "image": "NONE"}
    coded = labels if dictionary else False
    pq.write_table(table, shard_of(release), compression=how, use_dictionary=coded, **options)
    return table


def lying_footer(release):
    """A column of 1.2 GB in pages of zeros, of which the footer says that it has a few bytes."""
    large = {"data_page_size": 2**31 - 1, "write_statistics": False}
    table = text_in_a_shard(release, 1200, dictionary=False, **large)
    path = shard_of(release)
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


#: The same, behind new sums.
PACKED = {
    "deep metadata": (
        edited_manifest(lambda table: table.replace_schema_metadata({"slipstitch": DEEP})),
        "nested too deeply",
    ),
    "repeated images": (repeated_images, "compressed or coded again"),
    "coded images": (
        lambda one: pq.write_table(_rows(bytes(2**20), 400), shard_of(one), compression="zstd"),
        "compressed or coded again",
    ),
    "repeated text": (lambda one: text_in_a_shard(one, 1000), "a text of 1048576 bytes"),
    "a lying footer": (lying_footer, "takes far more memory than it has bytes"),
    "a repeated row of the manifest": (
        edited_manifest(lambda table: table.take(pa.array(np.zeros(200_000, np.int64)))),
        "rows compressed to",
    ),
    "a long text in the manifest": (with_materials(lambda k: LONG), "a text of 1048576 bytes"),
    # Another one in every row: together 1 MiB a row, packed to a few kB.
    "many long texts in the manifest": (with_materials(lambda k: f"{k}{LONG}"), "compressed to"),
}


def first_image(forger, side: int, content: bytes):
    """A PNG that says to have so many pixels a side as the first image of a shard."""
    header = side.to_bytes(4, "big") * 2 + bytes([8, 2, 0, 0, 0])
    body = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(content))
    image = b"\x89PNG\r\n\x1a\n" + body + chunk(b"IEND", b"")
    shard = f"data/{shard_of(forger.release).name}"
    forger.edit_rows(shard, lambda rows: rows[0]["image"].update(bytes=image))


def source(forger, content: bytes):
    (forger.release / "code/src/slipstitch/design/grid.py").write_bytes(content)


def records_in_a_circle(forger):
    def edit(one):
        inputs = (one["provenance"] or {}).get("inputs", {})
        inputs.update({"results/sample/manifest.parquet": "0" * 64})

    forger.edit_records("*", edit)


def records_of_other_kinds(forger):
    odd = {"inputs": {"a": 1}, "versions": [1], "git_commit": 3, "seed": {}}
    forger.edit_records("render/*", lambda one: one["provenance"].update(odd))
    forger.edit_records("simulate/*", lambda one: one["metadata"].update(solver=None, pinned="x"))
    forger.edit_records("sample/*", lambda one: one.update(metadata={"viewpoint": 1}))


FOUND = {
    "a huge image": (lambda one: first_image(one, 60_000, bytes(2**20)), "an image of more than"),
    "a growing image": (
        lambda one: first_image(one, 16, bytes(2**30)),
        "do not match the manifest",
    ),
    "a deep source": (
        lambda one: source(one, b"x = " + b"-" * 100_000 + b"1"),
        "its code digest is not that of",
    ),
    "a source that is none": (lambda one: source(one, b"\0\xff"), "its code digest is not that of"),
    "records in a circle": (records_in_a_circle, "broken chain"),
    "records of other kinds": (records_of_other_kinds, "broken chain"),
}


@pytest.mark.parametrize("name", [*REFUSED, *PACKED])
def test_hostile_folder_is_refused_in_one_line(forger, name):
    harm, what = (REFUSED | PACKED)[name]
    harm(forger.release)
    if name in PACKED:
        forger.reseal()
    code, said, cpu_s, rss = audited(forger.release)
    assert what in said and (code, said.count("\n")) == (2, 1), said
    assert cpu_s < CPU_S and rss < RSS_BYTES


@pytest.mark.parametrize("name", FOUND)
def test_hostile_content_is_found(forger, name):
    harm, what = FOUND[name]
    harm(forger)
    forger.reseal()
    code, said, _, rss = audited(forger.release)
    assert code == 1 and what in said and "Traceback" not in said, said
    assert rss < RSS_BYTES


def test_terminal_gets_no_control_characters(forger):
    name = "\x1b[2Jall intact\n"
    forger.edit_json("records/release.json", lambda one: one["facts"].update(name=name))
    forger.reseal()
    said = audited(forger.release)[1]
    assert "\x1b" not in said
    assert not any(line.startswith("all intact") for line in said.splitlines())


def test_json_in_the_test_is_deep_enough():
    with pytest.raises(RecursionError):
        json.loads(DEEP)
