"""The record that goes with every artefact."""

import json
import subprocess
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from slipstitch.base.provenance import (
    attach_metadata,
    file_digest,
    provenance_record,
    read_metadata,
    read_provenance,
    read_sidecar,
    start_clock,
    write_parquet,
    write_sidecar,
)
from slipstitch.config import Config


def test_record_says_what_made_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "in.txt").write_text("input")
    record = provenance_record(
        "render", inputs=[tmp_path / "in.txt"], config=Config().render, seed=3
    )
    assert record["inputs"] == {"in.txt": file_digest("in.txt")}
    assert record["config"]["pixels"] == Config().render.pixels
    assert record["seed"] == 3
    assert len(record["code_digest"]) == 64
    assert record["versions"]["numpy"] == np.__version__
    assert set(record) == {
        "stage", "inputs", "config", "code_digest", "git_commit", "git_dirty", "versions", "seed",
        "host_kind", "wall_s", "cpu_s",
    }  # fmt: skip
    json.dumps(record, allow_nan=False)


def test_record_names_no_place_on_this_machine_and_an_absent_input_is_an_error(
    tmp_path, monkeypatch
):
    (tmp_path / "work").mkdir()
    (tmp_path / "in.txt").write_text("input")
    monkeypatch.chdir(tmp_path / "work")
    record = provenance_record("render", inputs=[tmp_path / "in.txt"])
    assert str(tmp_path) not in json.dumps(record)
    with pytest.raises(FileNotFoundError):
        provenance_record("render", inputs=[tmp_path / "absent"])


def test_times_count_from_the_given_start():
    started = start_clock()
    busy_until = time.process_time() + 0.2
    while time.process_time() < busy_until:
        pass
    record = provenance_record("render", started=started)
    assert 0.2 <= record["cpu_s"] < 5
    assert record["wall_s"] >= 0.2


def test_sidecar_reads_back(tmp_path):
    path = tmp_path / "x.json"
    path.write_text("{}")
    record = {"config": {"frictions": np.array([0.1, 0.2])}, "seed": np.int64(3)}
    write_sidecar(path, record)
    assert (tmp_path / "x.json.provenance.json").is_file()
    assert read_sidecar(path) == {"config": {"frictions": [0.1, 0.2]}, "seed": 3}
    assert read_provenance(path) == read_sidecar(path)


def test_parquet_carries_metadata_and_record_beside_other_keys(tmp_path):
    path = tmp_path / "x.parquet"
    schema = pa.schema([("frame", pa.int32())], metadata={b"other": b"kept"})
    table = pa.table({"frame": pa.array([0, 1], pa.int32())}, schema=schema)
    table = attach_metadata(table, {"friction": 0.3, "pinned": (0, 4)})
    write_parquet(table, path, {"faces": np.array([[0, 1, 2]])}, {"seed": 7})
    assert read_metadata(path) == {
        "friction": 0.3,
        "pinned": [0, 4],
        "faces": [[0, 1, 2]],
        "provenance": {"seed": 7},
    }
    assert read_provenance(path) == {"seed": 7}
    assert pq.read_schema(path).metadata[b"other"] == b"kept"
    assert pq.read_table(path).column("frame").to_pylist() == [0, 1]


def test_a_file_without_record_says_so_and_metadata_refuse_what_json_cannot_hold(tmp_path):
    table = pa.table({"x": [1]})
    with pytest.raises(ValueError, match="JSON compliant"):
        attach_metadata(table, {"value": float("nan")})
    pq.write_table(table, tmp_path / "x.parquet")
    assert read_metadata(tmp_path / "x.parquet") == {}
    with pytest.raises(FileNotFoundError):
        read_provenance(tmp_path / "x.parquet")


def test_the_record_names_the_commit_of_the_checkout():
    root = Path(__file__).parents[2]
    words = ["git", "-C", str(root), "rev-parse", "HEAD"]
    answer = subprocess.run(words, capture_output=True, text=True)
    if answer.returncode:
        pytest.skip("no checkout")
    assert provenance_record("grid")["git_commit"] == answer.stdout.strip()
