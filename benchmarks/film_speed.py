"""What `slipstitch measure` answers where a video plays at a wrong speed.

    python benchmarks/film_speed.py VIDEO --camera CAMERA.json --model DIR --friction 0.23

The same packets are written with other times than the camera's: as by a camera whose clock is
wrong. A wrong answer must carry a note or an alarm, or be refused.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import av

SPEEDS = (1.0, 1.005, 0.995, 1.01, 0.99, 1.02, 0.98, 1.03, 0.97, 1.05, 0.95)


def played(video: Path, speed: float, out: Path) -> None:
    """Write the video as it plays at another speed."""
    with av.open(str(video)) as film, av.open(str(out), "w") as copy:
        stream = film.streams.video[0]
        to = copy.add_stream_from_template(stream)
        for packet in film.demux(stream):
            if packet.dts is not None:
                packet.pts, packet.dts = (round(at / speed) for at in (packet.pts, packet.dts))
                packet.stream = to
                copy.mux(packet)


def row(video: Path, words: list[str], speed: float) -> dict:
    """Result of one measurement: friction, interval, speed told, notes; or why there is none."""
    with tempfile.TemporaryDirectory() as folder:
        film, numbers = Path(folder) / video.name, Path(folder) / "numbers.json"
        played(video, speed, film)
        command = [sys.executable, "-m", "slipstitch", "measure", str(film), *words]
        command += ["--json", str(numbers)]
        answer = subprocess.run(command, capture_output=True, text=True)
        found = json.loads(numbers.read_text()) if numbers.is_file() else {}
    return {"exit": answer.returncode, "found": found, "said": answer.stdout + answer.stderr}


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("video", type=Path)
    parser.add_argument("--camera", required=True)
    parser.add_argument("--model", required=True)
    parser.add_argument("--friction", type=float, required=True, help="true friction coefficient")
    parser.add_argument("--json", type=Path, help="write everything that was answered")
    arguments = parser.parse_args()
    words = ["--camera", arguments.camera, "--model", arguments.model]
    rows = []
    for speed in SPEEDS:
        rows.append({"speed": speed, **row(arguments.video, words, speed)})
        print(f"## played at {speed:g} (exit code {rows[-1]['exit']}), true {arguments.friction:g}")
        print(rows[-1]["said"], flush=True)
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
