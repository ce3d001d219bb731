"""Duration of `slipstitch measure` for a video of the whole protocol, 131 s.

    python benchmarks/measure.py [--width 1280] [--rate 25] [--noise 6] [--key-frame-s 1]

The film is drawn by formula (tests/support/analytic_stage.py), enlarged, made noisy and compressed
by H.264; the instrument is the one that ships. Whether it raises its alarm does not matter here.
The noise decides how much there is to decode: with a standard deviation of 6 of 255 the film has
12 million bits a second, like a telephone's, with 2.5 only 0.1 million. What lies between two key
frames is not decoded where nobody needs it.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import cv2
import numpy as np
from support import analytic_stage as stage

from slipstitch.cli.measure import ALARM_EXIT_CODE
from slipstitch.config.catalogue import VIEWPOINTS
from slipstitch.images.camera import pose

REST_S = 4.0
DRAWN_WIDTH = 320
# Drawn anew this often once the start has been seen; frames between repeat the last drawing.
LATER_HZ = 3.0


def film(path: Path, width: int, rate_hz: float, noise: float, key_frame_s: float) -> int:
    """A film of the protocol; its number of frames."""
    height = width * 9 // 16 // 2 * 2
    small = (DRAWN_WIDTH, DRAWN_WIDTH * height // width)
    lens = stage.lens_camera(*pose(VIEWPOINTS["calibrated"]), size=(width, height))
    stage.camera_file(lens, path.with_name("camera.json"))
    drawn = stage.lens_camera(*pose(VIEWPOINTS["calibrated"]), size=small)
    scale = small[0] / width
    drawn.matrix[:] = lens.matrix
    drawn.matrix[:2] *= scale
    drawn.matrix[:2, 2] += (scale - 1) / 2
    bench = stage.Bench(drawn)
    times = np.arange(0, REST_S + stage.PATH.duration_s + 1, 1 / rate_hz)
    rng = np.random.default_rng(0)
    grain = rng.normal(0, noise, (2 * height, 2 * width, 1)).astype(np.float32)

    def frames():
        last_s, image = -1.0, None
        for time_s in times:
            now_s = time_s - REST_S
            if image is None or now_s - last_s >= (0 if now_s < 4 else 1 / LATER_HZ):
                image = cv2.resize(bench.image(now_s), (width, height)).astype(np.float32)
                last_s = now_s
            y, x = rng.integers(0, height), rng.integers(0, width)
            noisy = image + grain[y : y + height, x : x + width]
            yield np.clip(noisy, 0, 255).astype(np.uint8)

    group = str(round(key_frame_s * rate_hz))
    stage.write_video(path, frames(), times, crf="23", preset="veryfast", g=group)
    return len(times)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--width", type=int, default=1280)
    parser.add_argument("--rate", type=float, default=25.0)
    parser.add_argument("--noise", type=float, default=6.0, help="standard deviation, of 255")
    parser.add_argument("--key-frame-s", type=float, default=1.0, help="at most, between two")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        path = folder / "film.mp4"
        count = film(path, chosen.width, chosen.rate, chosen.noise, chosen.key_frame_s)
        size = path.stat().st_size
        words = ["film.mp4", "--camera", "camera.json", "--out", "page.html", "--threads", "2"]
        before, started = os.times(), time.perf_counter()
        answer = subprocess.run(
            [sys.executable, "-m", "slipstitch", "measure", *words],
            cwd=folder,
            text=True,
            stdout=subprocess.PIPE,
        )
        if answer.returncode not in (0, ALARM_EXIT_CODE):
            raise SystemExit(answer.returncode)
        wall_s, after = time.perf_counter() - started, os.times()
        cpu_s = after.children_user + after.children_system
        cpu_s -= before.children_user + before.children_system
        print(answer.stdout.strip())
        print(
            f"{count} frames of {chosen.width} pixels width, {size / 1e6:.0f} MB: "
            f"{wall_s:.1f} s, {cpu_s:.1f} CPU s (load {os.getloadavg()[0]:.1f})"
        )


if __name__ == "__main__":
    main()
