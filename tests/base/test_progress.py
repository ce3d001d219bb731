"""Progress: a bar for a person, lines for a log."""

import io
import sys

import pytest

import slipstitch.base.progress
from slipstitch.base.progress import progress


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_a_terminal_gets_a_bar_a_log_plain_lines_and_a_short_job_none(monkeypatch):
    for stream in (Terminal(), io.StringIO()):
        monkeypatch.setattr(sys, "stderr", stream)
        assert list(progress(range(3), unit="frame")) == [0, 1, 2]
        shown = stream.getvalue()
        assert ("\r" in shown and "3/3" in shown) if stream.isatty() else shown == ""
    monkeypatch.setattr(slipstitch.base.progress, "LINE_INTERVAL_S", 1e-9)
    with progress(unit="frame", total=4, description="light: ") as told:
        for _ in range(4):
            told.update()
    lines = stream.getvalue().splitlines()
    assert lines[0].startswith("light: 1 of 4 frames, 00:00 elapsed")
    assert "\r" not in stream.getvalue() and all(line == line.strip() for line in lines)


@pytest.mark.parametrize("stream", [io.StringIO(), Terminal()])
def test_what_goes_wrong_in_the_loop_is_not_hidden(monkeypatch, stream):
    monkeypatch.setattr(sys, "stderr", stream)
    with pytest.raises(ValueError, match="thread"), progress(unit="frame", total=2) as told:
        told.update()
        raise ValueError("thread")
