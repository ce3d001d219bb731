"""Untrusted input: nothing is executed, file names are only names, errors are one clean line."""

import ast
import json
import os
import pickle
import random
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pytest
import torch
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from safetensors.torch import save_file
from support import analytic_stage, fuzzing
from support.refusal import refused

from slipstitch.base import provenance
from slipstitch.base.errors import BadInput
from slipstitch.film.board import _frames
from slipstitch.film.recording import Recording
from slipstitch.learning.lrcn import load_model

SOURCES = sorted((Path(__file__).parents[2] / "src").rglob("*.py"))
# Modules and functions that run what they read.
FORBIDDEN_MODULES = {"pickle", "cPickle", "dill", "cloudpickle", "joblib", "marshal", "shelve"}
FORBIDDEN_CALLS = {
    "torch.load", "torch.save", "pd.read_pickle", "pandas.read_pickle", "yaml.load",
    "yaml.unsafe_load", "yaml.full_load", "yaml.load_all", "eval", "exec", "os.system",
}  # fmt: skip


def what_could_run(tree):
    """Names of what a source imports or calls that runs data."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from {alias.name.split(".")[0] for alias in node.names} & FORBIDDEN_MODULES
        elif isinstance(node, ast.ImportFrom):
            yield from {(node.module or "").split(".")[0]} & FORBIDDEN_MODULES
        elif isinstance(node, ast.Call):
            options = {keyword.arg: ast.unparse(keyword.value) for keyword in node.keywords}
            for option in ("allow_pickle", "shell"):
                if options.get(option) == "True":
                    yield option
            if ast.unparse(node.func) in FORBIDDEN_CALLS:
                yield ast.unparse(node.func)


def test_no_source_runs_what_it_reads():
    bad = "import pickle\nfrom joblib import load\nnp.load(x, allow_pickle=True)\nyaml.load(y)"
    assert list(what_could_run(ast.parse(bad))) == ["pickle", "joblib", "allow_pickle", "yaml.load"]
    found = {
        (source.name, name)
        for source in SOURCES
        for name in what_could_run(ast.parse(source.read_text(encoding="utf-8")))
    }
    # YAML goes to a loader of its own, which makes nothing that the safe one does not make.
    assert found == {("files.py", "yaml.load")}


def test_yaml_makes_plain_data_only(monkeypatch):
    used = []
    monkeypatch.setattr(yaml, "load", lambda text, Loader: used.append(Loader))
    provenance.load_yaml("a: 1", "here")
    (loader,) = used
    assert issubclass(loader, yaml.SafeLoader)
    for kind in ("yaml_constructors", "yaml_multi_constructors"):
        assert getattr(loader, kind) == getattr(yaml.SafeLoader, kind)


class Trap:
    """Unpickled, it leaves a file."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (Path.touch, (Path(self.path),))


@pytest.fixture(scope="session")
def readers(tmp_path_factory):
    return fuzzing.readers(tmp_path_factory.mktemp("hostile"))


@pytest.mark.slow
def test_no_reader_runs_a_pickle(readers, tmp_path):
    """A pickle in place of every file that is read leaves no trace but an error."""
    sprung = tmp_path / "sprung"
    content = pickle.dumps(Trap(str(sprung)))
    pickle.loads(content)
    assert sprung.exists()  # the trap works
    sprung.unlink()
    for reader in readers:
        assert fuzzing.bad_input_is_answered(reader, content) is None, reader.name
    assert not sprung.exists()


@pytest.mark.slow
def test_weights_of_another_shape_than_the_card_says_are_refused(tmp_path, readers):
    good = next(reader for reader in readers if reader.name == "model card").target
    card = json.loads(good.read_text())
    inside = {key: value for key, value in card.items() if key != "weights_sha256"}
    weights = {"x": torch.zeros(3)}
    save_file(weights, tmp_path / "model.safetensors", {"card": json.dumps(inside)})
    card["weights_sha256"] = provenance.file_digest(tmp_path / "model.safetensors")
    (tmp_path / "model.json").write_text(json.dumps(card))
    with pytest.raises(BadInput, match="weights do not match the card"):
        load_model(tmp_path)


NAMES = [
    "a b.parquet", "it's.parquet", 'a"b.parquet', "new\nline.parquet", "tab\t.parquet",
    "µ𝒳 ラ.parquet", "-rf.parquet", "$(touch pwned).parquet", "`touch pwned`;ls.parquet",
    "%s%n.parquet", "a*?[b].parquet", "\x1b[31mred.parquet", "right\u202eleft.parquet",
    "x" * 240 + ".parquet",
    os.fsdecode(b"not \xff text.parquet"), "..parquet", " .parquet",
]  # fmt: skip


@pytest.mark.parametrize("name", NAMES, ids=[ascii(name)[:20] for name in NAMES])
def test_a_files_name_is_only_a_name(name, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    Path("in").mkdir()
    (Path("in") / name).write_bytes(b"no Parquet")
    said = refused(capfd, ["render", "--preview", "--out-sheet", "x.png", f"in/{name}"])
    assert "damaged or not a Parquet file" in said
    assert said.rstrip("\n").isprintable()
    assert os.listdir() == ["in"]


@pytest.mark.parametrize("name", [name for name in NAMES if len(name) < 200])
def test_a_result_may_have_any_name(name, tmp_path):
    path = tmp_path / name
    provenance.write_parquet(pa.table({"x": [1]}), path)
    provenance.write_parquet(pa.table({"x": [2]}), path)
    assert provenance.read_parquet(path)["x"].to_pylist() == [2]
    assert os.listdir(tmp_path) == [name]


def test_dots_in_an_id_lead_nowhere(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("c.json").write_text("{}")
    command = "simulate --config c.json --simulation ../../etc/x --out x.parquet"
    assert "the grid has no simulation '../../etc/x'" in refused(capsys, command)


def film(path):
    image = np.random.default_rng(0).integers(0, 255, (32, 32, 3), np.uint8)
    return analytic_stage.write_avi(path, [image] * 6)


def test_a_video_that_claims_a_thousand_million_frames_is_read_to_its_real_end(tmp_path):
    path = film(tmp_path / "film.avi")
    content = bytearray(path.read_bytes())
    header = content.index(b"avih") + 8
    struct.pack_into("<I", content, header + 16, 10**9)  # dwTotalFrames
    stream = content.index(b"strh") + 8
    struct.pack_into("<I", content, stream + 32, 10**9)  # dwLength
    path.write_bytes(content)
    assert int(cv2.VideoCapture(str(path)).get(cv2.CAP_PROP_FRAME_COUNT)) >= 10**8
    assert 1 <= len(list(_frames(path))) <= 6


def test_a_video_whose_name_is_not_text_is_one_clear_line(tmp_path):
    path = film(tmp_path / "film.avi").rename(tmp_path / os.fsdecode(b"\xff.avi"))
    for read in (Recording, lambda path: list(_frames(path))):
        with pytest.raises(BadInput, match="the name is not text"):
            read(path)


def test_an_image_that_claims_more_pixels_than_memory_holds_is_refused():
    def chunk(kind, content):
        check = struct.pack(">I", zlib.crc32(kind + content))
        return struct.pack(">I", len(content)) + kind + content + check

    header = struct.pack(">IIBBBBB", 100_000, 100_000, 8, 2, 0, 0, 0)
    chunks = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b"")
    with pytest.raises(BadInput, match="an image of more than 67108864 pixels"):
        provenance.check_image(b"\x89PNG\r\n\x1a\n" + chunks, "x.png")


def test_a_file_called_like_an_address_is_a_file(tmp_path, monkeypatch):
    """Nor does a play list lead anywhere else."""
    monkeypatch.chdir(tmp_path)
    for name in ("concat:a|b.avi", "%03d.avi", "list.avi"):
        Path(name).write_text("#EXTM3U\n#EXTINF:1,\nhttp://127.0.0.1:9/x.ts\n")
        with pytest.raises(BadInput, match="not a video"):
            list(_frames(name))


@pytest.mark.slow
@settings(
    max_examples=150, deadline=None, derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)  # fmt: skip
@given(number=st.integers(0, 10**9), place=st.integers(0, 10**6))
def test_bad_input_ends_in_one_clean_error_soon_and_in_little_memory(readers, number, place):
    reader = readers[place % len(readers)]
    content = fuzzing.spoil(reader.target.read_bytes(), random.Random(number))
    assert fuzzing.bad_input_is_answered(reader, content) is None, reader.name


@pytest.mark.slow
@pytest.mark.parametrize("cell", ["=1+1", "+cmd|' /C calc'!A0", "@SUM(A1)", "-2+3", "\t=1"])
def test_a_cell_that_is_a_formula_is_no_number(cell, readers):
    reader = next(one for one in readers if one.name.endswith("/drop_drag_runs.csv"))
    good = reader.target.read_text()
    head, row, *rows = good.splitlines()
    spoilt = [head, f"{row.rpartition(',')[0]},{cell}", *rows]
    reader.target.write_text("\n".join(spoilt) + "\n")
    try:
        with pytest.raises(BadInput, match=f"column {head.rpartition(',')[2]}"):
            reader.read()
    finally:
        reader.target.write_text(good)


def test_the_machine_refusing_is_one_line(tmp_path):
    """A file that may not grow beyond 4 kB: what a full disk looks like to a program."""
    code = (
        "import resource, signal, sys; signal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096));"
        "from slipstitch.cli.main import main; sys.exit(main(sys.argv[1:]))"
    )
    words = ["simulate", "--material", "gray-interlock", "--friction", "0.3", "--set", "frames=2",
             "--set", "vertices_per_side=9", "--out", str(tmp_path / "x.parquet")]  # fmt: skip
    run = [sys.executable, "-c", code, *words]
    answer = subprocess.run(run, capture_output=True, text=True, cwd=tmp_path)
    assert answer.returncode == 1 and "Traceback" not in answer.stderr
    assert "file too large" in answer.stderr.splitlines()[-1]
    assert os.listdir(tmp_path) == []
