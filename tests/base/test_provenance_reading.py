"""Files that are damaged or made to do harm: one clear error, quickly, within little memory."""

import hashlib
import json
import os
import time

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from slipstitch.base.errors import BadInput, Damaged
from slipstitch.base.provenance import (
    atomic_path,
    load_yaml,
    read_json,
    read_metadata,
    read_parquet,
    read_provenance,
    read_sidecar,
    read_yaml,
    write_parquet,
    write_sidecar,
)


@pytest.fixture
def table(tmp_path):
    path = tmp_path / "x.parquet"
    values = np.random.default_rng(0).normal(size=5000)
    columns = {"value": values, "name": [f"row {k}" for k in range(5000)]}
    write_parquet(pa.table(columns), path, {"friction": 0.3, "simulation": "m00"})
    return path


def test_what_was_written_reads_back(table):
    assert read_parquet(table, ["value"]).num_rows == 5000
    assert read_metadata(table)["friction"] == 0.3
    keys = pq.read_schema(table).metadata
    want = hashlib.sha256(keys[b"slipstitch"]).hexdigest()
    assert keys[b"slipstitch_sha256"].decode() == want
    assert json.loads(keys[b"slipstitch"])["simulation"] == "m00"


def test_no_flipped_bit_of_a_parquet_file_changes_what_is_read_unnoticed(table):
    """One bit at every 97th byte: an error, or the very same content."""
    whole = table.read_bytes()
    want, notes = read_parquet(table), read_metadata(table)
    noticed = 0
    for place in range(0, len(whole), 97):
        damaged = bytearray(whole)
        damaged[place] ^= 1 << (place % 8)
        table.write_bytes(damaged)
        try:
            assert read_parquet(table).equals(want), place
            assert read_metadata(table) == notes, place
        except Damaged:
            noticed += 1
    assert noticed > 0.9 * len(whole) / 97


def test_text_that_is_none_is_noticed_in_files_of_others_too(tmp_path):
    """They carry no checksums."""
    path = tmp_path / "x.parquet"
    pq.write_table(pa.table({"name": ["abcdefgh", "ijklmnop"]}), path, compression="none")
    for text in (b"abcdefgh", b"name"):
        damaged = path.read_bytes().replace(text, b"\xfd" + text[1:])
        (tmp_path / "y.parquet").write_bytes(damaged)
        with pytest.raises(Damaged, match=r"y\.parquet"):
            read_parquet(tmp_path / "y.parquet")


@pytest.mark.parametrize("share", [0.0, 0.001, 0.3, 0.99])
def test_a_truncated_parquet_file_is_named(table, share):
    whole = table.read_bytes()
    table.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(Damaged, match=r"x\.parquet: damaged or not a Parquet file"):
        read_parquet(table)


def test_a_parquet_file_that_grows_beyond_measure_is_refused(tmp_path):
    path = tmp_path / "bomb.parquet"
    pq.write_table(pa.table({"x": np.zeros(10_000_000, np.int64)}), path, compression="zstd")
    assert path.stat().st_size < 10_000_000 / 100
    with pytest.raises(Damaged, match="claims"):
        read_parquet(path)


def test_only_files_of_the_results_are_said_to_be_made_anew():
    assert "--forcerun 'results/a b.parquet'" in str(Damaged("results/a b.parquet", "damaged"))
    assert "forcerun" not in str(Damaged("/data/x.parquet", "damaged"))
    assert "forcerun" not in str(Damaged("mine/x.parquet", "damaged"))


def test_json_that_is_not_what_its_record_was_written_for_is_damaged(tmp_path):
    path = tmp_path / "x.json"
    with atomic_path(path) as temporary:
        temporary.write_text('{"friction": 0.3}')
    write_sidecar(path, {"stage": "x"})
    assert read_json(path) == {"friction": 0.3}
    path.write_text('{"friction": 0.7}')
    with pytest.raises(Damaged, match="its content does not match its record"):
        read_json(path)


@pytest.mark.parametrize("text", ["[]", "null", '"x"', "3", "{", "[" * 200_000])
def test_a_record_that_is_no_mapping_is_damaged(tmp_path, text):
    path = tmp_path / "x.json"
    path.write_text("{}")
    path.with_name("x.json.provenance.json").write_text(text)
    for read in (read_json, read_sidecar, read_provenance):
        with pytest.raises(Damaged, match=r"x\.json\.provenance\.json: damaged or not a record"):
            read(path)


@pytest.mark.parametrize("text", ["", "{", "[" * 200_000, '{"a": NaNs}', "9" * 10_000, "\x00"])
def test_what_is_no_json_is_damaged(tmp_path, text):
    (tmp_path / "x.json").write_text(text)
    with pytest.raises(Damaged):
        read_json(tmp_path / "x.json")


BOMB = "a: &a [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{b}: &{b} [{', '.join(['*' + a] * 10)}]\n"
    for a, b in zip("abcdefghij", "bcdefghijk", strict=True)
)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (BOMB, "more than 100000 values"),
        ("a: &a [*a]", "more than 100000 values"),
        ("[" * 50_000, "nested too deeply"),
        ("x" * 300_000, "at most 262144 are allowed"),
        ("a: !!python/object/apply:os.system ['touch pwned']", "not YAML"),
        ("a: !!python/name:os.system", "not YAML"),
        ("!!python/object/new:subprocess.Popen [[ls]]", "not YAML"),
        ("a: 2026-13-45", "not YAML"),
        ("a: [", "not YAML"),
        ("\x00", "not YAML"),
    ],
)
def test_yaml_that_would_do_harm_is_refused_at_once(text, problem, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(BadInput, match="No such file"):
        read_yaml("x.yaml")
    began = time.process_time()
    with pytest.raises(BadInput, match=problem):
        load_yaml(text, "mine.yaml")
    assert time.process_time() - began < 10
    assert os.listdir(tmp_path) == []
    (tmp_path / "x.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(BadInput, match="not a text file"):
        read_yaml("x.yaml")


def test_a_key_given_twice_is_refused_with_its_line():
    with pytest.raises(BadInput, match=r"here: line 3: not YAML: key 'frames' is given twice"):
        load_yaml("simulation:\n  frames: 5\n  frames: 6\n", "here")
    assert load_yaml("{a: {frames: 1}, b: {frames: 2}}", "here")["b"] == {"frames": 2}
    assert load_yaml("a: &x {f: 1}\nb: {<<: *x, g: 2}", "here")["b"] == {"f": 1, "g": 2}
