"""Files are there completely or not at all."""

import hashlib
import os
import signal
import subprocess
import sys

import pytest

from slipstitch.base.provenance import atomic_path, file_digest


def leftovers(folder):
    return sorted(path.name for path in folder.iterdir())


def test_file_takes_its_name_when_the_block_ends_and_a_failure_leaves_the_old_one(tmp_path):
    target = tmp_path / "deep" / "x.json"
    with atomic_path(target) as temporary:
        temporary.write_text("old")
        assert not target.exists()
        assert temporary.suffix == ".json"
        assert temporary.stat().st_dev == target.parent.stat().st_dev
    with pytest.raises(RuntimeError, match="half"), atomic_path(target) as temporary:
        temporary.write_text("ne")
        raise RuntimeError("half way")
    assert target.read_text() == "old"
    assert leftovers(target.parent) == ["x.json"]


def test_block_that_wrote_nothing_fails(tmp_path):
    with pytest.raises(FileNotFoundError, match="nothing was written"), atomic_path(tmp_path / "x"):
        pass
    assert leftovers(tmp_path) == []


def test_digest_is_sha256_of_the_bytes(tmp_path):
    content = bytes(range(256)) * 5000
    (tmp_path / "x").write_bytes(content)
    assert file_digest(tmp_path / "x") == hashlib.sha256(content).hexdigest()


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
    with atomic_path(target) as temporary:
        temporary.write_text("again")
    assert leftovers(tmp_path) == ["x.json"]


def test_what_another_living_process_writes_is_left_alone(tmp_path):
    target = tmp_path / "x.json"
    with atomic_path(target) as first:
        first.write_text("first")
        with atomic_path(target) as second:
            second.write_text("second")
        assert first.read_text() == "first"
    assert target.read_text() == "first"
    assert leftovers(tmp_path) == ["x.json"]


def test_a_folder_that_has_only_just_been_made_is_left_alone(tmp_path):
    """Its process may not have locked it yet."""
    folder = tmp_path / ".x.abcd1234.tmp"
    folder.mkdir()
    with atomic_path(tmp_path / "x.json") as temporary:
        temporary.write_text("")
    assert folder.exists()
    os.utime(folder, (0, 0))
    with atomic_path(tmp_path / "x.json") as temporary:
        temporary.write_text("")
    assert not folder.exists()


def test_a_folder_is_replaced_as_a_whole_and_never_half_there(tmp_path, monkeypatch):
    target = tmp_path / "set"
    (target / "inner").mkdir(parents=True)
    for k in range(3):
        (target / "inner" / f"{k}").write_text("old")
    seen = []
    replace = os.replace

    def watched(source, destination):
        replace(source, destination)
        seen.append(sorted(path.read_text() for path in target.rglob("*") if path.is_file()))

    monkeypatch.setattr(os, "replace", watched)
    with atomic_path(target) as temporary:
        temporary.mkdir()
        for k in range(3):
            (temporary / f"{k}").write_text("new")
    assert seen == [[], ["new"] * 3]
    assert leftovers(tmp_path) == ["set"]
