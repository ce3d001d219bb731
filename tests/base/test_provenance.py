"""Files are there completely or not at all, say what made them, are read or refused."""

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from slipstitch.base import provenance
from slipstitch.base.errors import BadInput, Damaged
from slipstitch.base.provenance import atomic_path, file_digest, provenance_record, read_parquet
from slipstitch.config import Config


def leftovers(folder):
    return sorted(path.name for path in folder.iterdir())


def written(path, text):
    with atomic_path(path) as temporary:
        temporary.write_text(text)


def test_file_takes_its_name_when_the_block_ends_and_a_failure_leaves_the_old_one(tmp_path):
    target = tmp_path / "deep" / "x.json"
    with atomic_path(target) as temporary:
        temporary.write_text("old")
        assert not target.exists() and temporary.suffix == ".json"
        assert temporary.stat().st_dev == target.parent.stat().st_dev
    with pytest.raises(RuntimeError, match="half"), atomic_path(target) as temporary:
        temporary.write_text("ne")
        raise RuntimeError("half way")
    with pytest.raises(FileNotFoundError, match="nothing was written"), atomic_path(target):
        pass
    assert (target.read_text(), leftovers(target.parent)) == ("old", ["x.json"])
    assert file_digest(target) == hashlib.sha256(b"old").hexdigest()


KILLED = """
import os, signal, sys
from slipstitch.base.provenance import atomic_path, files

def killed(path):
    os.kill(os.getpid(), signal.SIGKILL)

calls = iter(range(9))
flush = files._flush
files._flush = lambda path: killed(path) if next(calls) == int(sys.argv[2]) else flush(path)
with atomic_path(sys.argv[1]) as temporary:
    temporary.write_text("whole")
"""


@pytest.mark.parametrize("flushes", [0, 1], ids=["before it has its name", "after"])
def test_what_a_kill_leaves_is_removed_at_once_by_the_next_attempt(tmp_path, flushes):
    """After the renaming the temporary folder holds no file any more, and yet is abandoned."""
    target = tmp_path / "x.json"
    words = [sys.executable, "-c", KILLED, str(target), str(flushes)]
    assert subprocess.run(words).returncode == -signal.SIGKILL
    assert target.exists() == bool(flushes)
    assert [name for name in leftovers(tmp_path) if name.endswith(".tmp")]
    written(target, "again")
    assert leftovers(tmp_path) == ["x.json"]


def test_what_another_living_process_writes_is_left_alone(tmp_path):
    """Also a folder that its process may not have locked yet."""
    target, young = tmp_path / "x.json", tmp_path / ".x.abcd1234.tmp"
    young.mkdir()
    with atomic_path(target) as first:
        first.write_text("first")
        written(target, "second")
        assert first.read_text() == "first"
    assert target.read_text() == "first" and young.exists()
    os.utime(young, (0, 0))
    written(target, "third")
    assert leftovers(tmp_path) == ["x.json"]


def test_a_folder_is_replaced_as_a_whole_and_never_half_there(tmp_path, monkeypatch):
    inner = tmp_path / "set" / "inner"
    inner.mkdir(parents=True)
    for k in range(3):
        (inner / f"{k}").write_text("old")
    seen, replace = [], os.replace

    def watched(source, destination):
        replace(source, destination)
        there = (path for path in (tmp_path / "set").rglob("*") if path.is_file())
        seen.append([path.read_text() for path in there])

    monkeypatch.setattr(os, "replace", watched)
    with atomic_path(tmp_path / "set") as temporary:
        temporary.mkdir()
        for k in range(3):
            (temporary / f"{k}").write_text("new")
    assert seen == [[], ["new"] * 3]
    assert leftovers(tmp_path) == ["set"]


def test_record_says_what_made_it_and_names_no_place_on_this_machine(tmp_path, monkeypatch):
    (tmp_path / "work").mkdir()
    (tmp_path / "in.txt").write_text("input")
    config = Config().render
    for folder in (tmp_path, tmp_path / "work"):
        monkeypatch.chdir(folder)
        record = provenance_record("render", inputs=[tmp_path / "in.txt"], config=config, seed=3)
        assert record["inputs"] == {"in.txt": file_digest(tmp_path / "in.txt")}
        assert str(tmp_path) not in json.dumps(record, allow_nan=False)
    assert (record["config"]["pixels"], record["seed"]) == (config.pixels, 3)
    assert record["versions"]["numpy"] == np.__version__ and len(record["code_digest"]) == 64
    assert set(record) == {
        "stage", "inputs", "config", "code_digest", "git_commit", "git_dirty", "versions", "seed",
        "host_kind", "wall_s", "cpu_s",
    }  # fmt: skip
    with pytest.raises(FileNotFoundError):
        provenance_record("render", inputs=[tmp_path / "absent"])


def test_times_count_from_the_given_start():
    started = provenance.start_clock()
    busy_until = time.process_time() + 0.2
    while time.process_time() < busy_until:
        pass
    record = provenance_record("render", started=started)
    assert 0.2 <= record["cpu_s"] < 5 and record["wall_s"] >= 0.2


def test_sidecar_reads_back(tmp_path):
    path = tmp_path / "x.json"
    path.write_text("{}")
    record = {"config": {"frictions": np.array([0.1, 0.2])}, "seed": np.int64(3)}
    provenance.write_sidecar(path, record)
    assert (tmp_path / "x.json.provenance.json").is_file()
    assert provenance.read_sidecar(path) == {"config": {"frictions": [0.1, 0.2]}, "seed": 3}
    assert provenance.read_provenance(path) == provenance.read_sidecar(path)


def test_parquet_carries_metadata_with_their_digest_and_record_beside_other_keys(tmp_path):
    path = tmp_path / "x.parquet"
    schema = pa.schema([("frame", pa.int32())], metadata={b"other": b"kept"})
    table = pa.table({"frame": pa.array([0, 1], pa.int32())}, schema=schema)
    table = provenance.attach_metadata(table, {"friction": 0.3, "pinned": (0, 4)})
    provenance.write_parquet(table, path, {"faces": np.array([[0, 1, 2]])}, {"seed": 7})
    known = {"friction": 0.3, "pinned": [0, 4], "faces": [[0, 1, 2]]}
    assert provenance.read_metadata(path) == known | {"provenance": {"seed": 7}}
    assert provenance.read_provenance(path) == {"seed": 7}
    keys = pq.read_schema(path).metadata
    digest = hashlib.sha256(keys[b"slipstitch"]).hexdigest()
    assert (keys[b"other"], keys[b"slipstitch_sha256"].decode()) == (b"kept", digest)
    assert read_parquet(path, ["frame"])["frame"].to_pylist() == [0, 1]


def test_a_file_without_record_says_so_and_metadata_refuse_what_json_cannot_hold(tmp_path):
    table = pa.table({"x": [1]})
    with pytest.raises(ValueError, match="JSON compliant"):
        provenance.attach_metadata(table, {"value": float("nan")})
    pq.write_table(table, tmp_path / "x.parquet")
    assert provenance.read_metadata(tmp_path / "x.parquet") == {}
    with pytest.raises(FileNotFoundError):
        provenance.read_provenance(tmp_path / "x.parquet")


def test_the_record_names_the_commit_of_the_checkout():
    words = ["git", "-C", str(Path(__file__).parents[2]), "rev-parse", "HEAD"]
    answer = subprocess.run(words, capture_output=True, text=True)
    if answer.returncode:
        pytest.skip("no checkout")
    assert provenance_record("grid")["git_commit"] == answer.stdout.strip()


@pytest.fixture
def table(tmp_path):
    path = tmp_path / "x.parquet"
    values = np.random.default_rng(0).normal(size=5000)
    columns = {"value": values, "name": [f"row {k}" for k in range(5000)]}
    provenance.write_parquet(pa.table(columns), path, {"friction": 0.3, "simulation": "m00"})
    return path


def test_no_flipped_or_missing_bit_of_a_parquet_file_goes_unnoticed(table):
    """One bit at every 97th byte: an error, or the very same content."""
    whole = table.read_bytes()
    want, notes = read_parquet(table), provenance.read_metadata(table)
    noticed = 0
    for place in range(0, len(whole), 97):
        damaged = bytearray(whole)
        damaged[place] ^= 1 << (place % 8)
        table.write_bytes(damaged)
        try:
            assert read_parquet(table).equals(want), place
            assert provenance.read_metadata(table) == notes, place
        except Damaged:
            noticed += 1
    assert noticed > 0.9 * len(whole) / 97
    for share in (0.0, 0.001, 0.3, 0.99):
        table.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(Damaged, match=r"x\.parquet: damaged or not a Parquet file"):
            read_parquet(table)


def test_text_that_is_none_is_noticed_in_files_of_others_too(tmp_path):
    """They carry no checksums."""
    path = tmp_path / "x.parquet"
    pq.write_table(pa.table({"name": ["abcdefgh", "ijklmnop"]}), path, compression="none")
    for text in (b"abcdefgh", b"name"):
        damaged = path.read_bytes().replace(text, b"\xfd" + text[1:])
        (tmp_path / "y.parquet").write_bytes(damaged)
        with pytest.raises(Damaged, match=r"y\.parquet"):
            read_parquet(tmp_path / "y.parquet")


def test_a_parquet_file_that_grows_beyond_measure_is_refused(tmp_path):
    path = tmp_path / "bomb.parquet"
    pq.write_table(pa.table({"x": np.zeros(10_000_000, np.int64)}), path, compression="zstd")
    assert path.stat().st_size < 10_000_000 / 100
    with pytest.raises(Damaged, match="claims"):
        read_parquet(path)


def test_only_files_of_the_results_are_said_to_be_made_anew():
    assert "--forcerun 'results/a b.parquet'" in str(Damaged("results/a b.parquet", "damaged"))
    for path in ("/data/x.parquet", "mine/x.parquet"):
        assert "forcerun" not in str(Damaged(path, "damaged"))


def test_json_that_is_not_what_its_record_was_written_for_is_damaged(tmp_path):
    path = tmp_path / "x.json"
    written(path, '{"friction": 0.3}')
    provenance.write_sidecar(path, {"stage": "x"})
    assert provenance.read_json(path) == {"friction": 0.3}
    path.write_text('{"friction": 0.7}')
    with pytest.raises(Damaged, match="its content does not match its record"):
        provenance.read_json(path)


@pytest.mark.parametrize("text", ["[]", "null", '"x"', "3", "{", "[" * 200_000])
def test_a_record_that_is_no_mapping_is_damaged(tmp_path, text):
    path = tmp_path / "x.json"
    path.write_text("{}")
    path.with_name("x.json.provenance.json").write_text(text)
    for read in (provenance.read_json, provenance.read_sidecar, provenance.read_provenance):
        with pytest.raises(Damaged, match=r"x\.json\.provenance\.json: damaged or not a record"):
            read(path)


@pytest.mark.parametrize("text", ["", "{", "[" * 200_000, '{"a": NaNs}', "9" * 10_000, "\x00"])
def test_what_is_no_json_is_damaged(tmp_path, text):
    (tmp_path / "x.json").write_text(text)
    with pytest.raises(Damaged):
        provenance.read_json(tmp_path / "x.json")


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
        provenance.read_yaml("x.yaml")
    began = time.process_time()
    with pytest.raises(BadInput, match=problem):
        provenance.load_yaml(text, "mine.yaml")
    assert time.process_time() - began < 10 and os.listdir(tmp_path) == []
    (tmp_path / "x.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(BadInput, match="not a text file"):
        provenance.read_yaml("x.yaml")


def test_a_key_given_twice_is_refused_with_its_line():
    with pytest.raises(BadInput, match=r"here: line 3: not YAML: key 'frames' is given twice"):
        provenance.load_yaml("simulation:\n  frames: 5\n  frames: 6\n", "here")
    assert provenance.load_yaml("{a: {frames: 1}, b: {frames: 2}}", "here")["b"] == {"frames": 2}
    assert provenance.load_yaml("a: &x {f: 1}\nb: {<<: *x, g: 2}", "here")["b"] == {"f": 1, "g": 2}
