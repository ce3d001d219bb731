"""Progress of a loop: a bar on a terminal, otherwise a plain line at intervals."""

import sys
from collections.abc import Iterable
from typing import TextIO

from tqdm import tqdm

LINE_INTERVAL_S = 30.0
_LINE = "{desc}{n_fmt} of {total_fmt} {unit}s, {elapsed} elapsed, {remaining} remaining"


def note(*lines: str) -> None:
    """Say on stderr what was assumed, a line each."""
    for line in lines:
        print(line, file=sys.stderr)


class _Lines:
    """A stream that gets whole lines from a bar that redraws itself."""

    def __init__(self, stream: TextIO):
        self._stream = stream

    def write(self, text: str) -> None:
        if line := text.strip():
            self._stream.write(line + "\n")

    def flush(self) -> None:
        self._stream.flush()


def progress(
    items: Iterable | None = None,
    description: str | None = None,
    *,
    unit: str,
    total: int | None = None,
) -> tqdm:
    """A tqdm bar over `items`, or one that is told with ``update``, on stderr.

    Where stderr is no terminal (a log, a pipe), it writes a line every `LINE_INTERVAL_S` seconds
    and nothing at all in jobs that are shorter. `description` goes in front, `unit` is one item in
    the singular; `total` says how many there are.
    """
    options: dict = {"unit": unit, "total": total, "desc": description}
    if sys.stderr.isatty():
        return tqdm(items, file=sys.stderr, **options)
    options |= {"mininterval": LINE_INTERVAL_S, "delay": LINE_INTERVAL_S, "miniters": 1}
    return tqdm(items, file=_Lines(sys.stderr), bar_format=_LINE, leave=False, **options)
