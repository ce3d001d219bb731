"""Invalid inputs for every reader: does any cause a traceback, crash, hang or excessive memory use?

Every process reads a few hundred; one that dies or hangs is seen from outside, and its input kept.
"""

import argparse
import contextlib
import faulthandler
import json
import os
import random
import resource
import signal
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support import fuzzing

CHUNK = 400
HANG_S = 30.0  # seen from outside: the reader itself is held to fuzzing.TIME_LIMIT_S
ADDRESS_SPACE_BYTES = 16 * 2**30


def one_chunk(readers, first: int, last: int, seed: int, keep: Path) -> dict:
    """Inputs first ... last - 1, in a process of their own."""
    notes = keep / "progress.json"
    notes.write_text(json.dumps({"next": first, "problems": [], "peak_bytes": 0}))
    child = os.fork()
    if child == 0:
        status = 1
        try:
            read_all(readers, first, last, seed, keep, notes)
            status = 0
        finally:
            os._exit(status)
    until, before = time.monotonic() + HANG_S, first
    while True:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            break
        with contextlib.suppress(ValueError):  # being written
            now = json.loads(notes.read_text())["next"]
            if now != before:
                until, before = time.monotonic() + HANG_S, now
        if time.monotonic() > until:
            os.kill(child, signal.SIGKILL)
        time.sleep(0.05)
    done = json.loads(notes.read_text())
    if status:
        code = os.waitstatus_to_exitcode(status)
        what = f"process ended with {code} (-9: hung, -11: crashed)"
        done["problems"].append([done["next"], readers[done["next"] % len(readers)].name, what])
        done["next"] += 1
    return done


def read_all(readers, first: int, last: int, seed: int, keep: Path, notes: Path) -> None:
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # what libraries mutter
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE_BYTES, ADDRESS_SPACE_BYTES))
    problems = []
    for number in range(first, last):
        reader = readers[number % len(readers)]
        content = fuzzing.spoil(reader.target.read_bytes(), random.Random(f"{seed} {number}"))
        (keep / "input").write_bytes(content)
        write(notes, number, problems)
        problem = fuzzing.bad_input_is_answered(reader, content)
        if problem:
            problems.append([number, reader.name, problem])
            (keep / f"{number}").write_bytes(content)
    write(notes, last, problems)


def write(notes: Path, number: int, problems: list) -> None:
    peak = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    part = notes.with_suffix(".part")
    part.write_text(json.dumps({"next": number, "problems": problems, "peak_bytes": peak}))
    part.replace(notes)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=1e9, help="begin nothing after this time")
    parser.add_argument(
        "--only",
        nargs="+",
        default=[""],
        help="readers whose names have one of these words in them",
    )
    parser.add_argument("--keep", type=Path, help="folder for inputs that were answered wrongly")
    arguments = parser.parse_args()
    faulthandler.enable()
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as temporary:
        keep = arguments.keep or Path(temporary) / "kept"
        keep.mkdir(parents=True, exist_ok=True)
        (Path(temporary) / "good").mkdir()
        readers = fuzzing.readers(Path(temporary) / "good")
        readers = [one for one in readers if any(word in one.name for word in arguments.only)]
        print(f"{len(readers)} readers", flush=True)
        number, problems, peak = 0, [], 0
        while number < arguments.inputs and time.monotonic() - began < 60 * arguments.minutes:
            last = min(number + CHUNK, arguments.inputs)
            done = one_chunk(readers, number, last, arguments.seed, keep)
            number, peak = done["next"], max(peak, done["peak_bytes"])
            problems += done["problems"]
            print(f"{number}: {len(problems)} problems", flush=True)
    for _, name, problem in problems:
        print(f"{name}: {problem}")
    cpu_s = sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2])
    print(
        f"{number} inputs for {len(readers)} readers, {cpu_s:.0f} CPU s: {len(problems)} problems"
    )
    print(f"largest memory of a process: {peak / 2**20:.0f} MiB")
    print("by reader:", dict(Counter(name for _, name, _ in problems)))
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
