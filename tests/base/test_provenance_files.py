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


def test_file_takes_its_name_when_the_block_ends(tmp_path):
    target = tmp_path / "deep" / "x.json"
    with atomic_path(target) as temporary:
        temporary.write_text("new")
        assert not target.exists()
        assert temporary.suffix == ".json"
        assert temporary.stat().st_dev == target.parent.stat().st_dev
    assert target.read_text() == "new"
    assert leftovers(target.parent) == ["x.json"]


def test_failure_leaves_the_old_file_and_nothing_else(tmp_path):
    target = tmp_path / "x.json"
    target.write_text("old")
    with pytest.raises(RuntimeError, match="half"), atomic_path(target) as temporary:
        temporary.write_text("ne")
        raise RuntimeError("half way")
    assert target.read_text() == "old"
    assert leftovers(tmp_path) == ["x.json"]


def test_block_that_wrote_nothing_fails(tmp_path):
    with pytest.raises(FileNotFoundError, match="nothing was written"), atomic_path(tmp_path / "x"):
        pass
    assert leftovers(tmp_path) == []


def test_folder_replaces_a_folder_as_a_whole(tmp_path):
    target = tmp_path / "set"
    target.mkdir()
    (target / "stale").write_text("")
    with atomic_path(target) as temporary:
        (temporary / "inner").mkdir(parents=True)
        (temporary / "inner" / "fresh").write_text("")
    assert [path.name for path in target.rglob("*")] == ["inner", "fresh"]
    assert leftovers(tmp_path) == ["set"]


def test_digest_is_sha256_of_the_bytes(tmp_path):
    content = bytes(range(256)) * 5000
    (tmp_path / "x").write_bytes(content)
    assert file_digest(tmp_path / "x") == hashlib.sha256(content).hexdigest()


def abandoned(target, content="half"):
    """What a process that was killed leaves: its folder, without its lock."""
    folder = target.parent / f".{target.stem}.abcd1234.tmp"
    folder.mkdir()
    (folder / target.name).write_text(content)
    return folder


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


def test_what_a_killed_process_left_is_removed_by_the_next_attempt(tmp_path):
    target = tmp_path / "x.json"
    abandoned(target)
    with atomic_path(target) as temporary:
        temporary.write_text("whole")
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
    folder = abandoned(tmp_path / "x.json")
    (folder / "x.json").unlink()
    with atomic_path(tmp_path / "x.json") as temporary:
        temporary.write_text("")
    assert folder.exists()
    os.utime(folder, (0, 0))
    with atomic_path(tmp_path / "x.json") as temporary:
        temporary.write_text("")
    assert not folder.exists()


def test_a_folder_is_never_half_there_while_it_is_replaced(tmp_path, monkeypatch):
    target = tmp_path / "set"
    target.mkdir()
    for k in range(3):
        (target / f"{k}").write_text("old")
    seen = []
    replace = os.replace

    def watched(source, destination):
        replace(source, destination)
        seen.append(sorted(path.read_text() for path in target.rglob("*")))

    monkeypatch.setattr(os, "replace", watched)
    with atomic_path(target) as temporary:
        temporary.mkdir()
        for k in range(3):
            (temporary / f"{k}").write_text("new")
    assert seen == [[], ["new"] * 3]
    assert leftovers(tmp_path) == ["set"]
