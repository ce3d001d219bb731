"""Cost of images: Blender and textures separately, memory and open files of a long process.

    python benchmarks/render.py                          # cost, at least 2000 images
    python benchmarks/render.py --long 500 --pixels 32   # one process, 500 frames

The cloth is the made-up one of the tests: what an image costs depends on how much of it the cloth
fills, not on how the cloth moves.
"""

import argparse
import math
import os
import resource
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from support import synthetic_cloth

from slipstitch.config.render import RenderSettings
from slipstitch.design.grid import texture_ids
from slipstitch.images import blender
from slipstitch.images.encoding import encode_png
from slipstitch.images.image_shards import composed_images, render_shard
from slipstitch.images.packing import read_pack, write_pack
from slipstitch.images.view import View
from slipstitch.physics.simulation.trajectory import Trajectory, write_trajectory

TEXTURES = ["stripes", "checks", "tartan", "dots", "houndstooth", "floral", "denim", "linen"]
VIEWPOINTS = ["calibrated", "frontal", "side"]
# The paper's dataset: simulations, viewpoints, sampled frames.
PAPER_FRAMES, PAPER_IMAGES = 160 * 3 * 30, 160 * 3 * 30 * 8


def cpu_s() -> float:
    """CPU seconds of this process."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


def resident_mb() -> float:
    """Memory of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20


def open_files() -> int:
    """File descriptors of this process."""
    return len(os.listdir("/proc/self/fd"))


class Stopwatch:
    """CPU time inside Blender's render call."""

    def __init__(self):
        self.spent_s = 0.0
        original = blender.ClothScene.render

        def timed(scene, *arguments, **options):
            start = cpu_s()
            result = original(scene, *arguments, **options)
            self.spent_s += cpu_s() - start
            return result

        blender.ClothScene.render = timed


def view(path: Path, settings: RenderSettings, viewpoint: str, frames: int) -> View:
    """A view of the benchmark."""
    return View(path, "v00", viewpoint, settings, frames, 1, None, texture_ids(settings))


def cost(folder: Path, pixels: int, images: int, floor: str) -> None:
    """Print what a frame and an image cost, viewpoint by viewpoint, and the paper's dataset."""
    frames = math.ceil(images / len(TEXTURES) / len(VIEWPOINTS))
    settings = RenderSettings(pixels=pixels, textures=TEXTURES, floors=[floor])
    path = folder / "m00_f0100_r00.parquet"
    write_trajectory(path, Trajectory(**synthetic_cloth.motion(frames, n=41)))
    watch = Stopwatch()
    shading_s = image_s = blender_s = 0.0
    count = 0
    for viewpoint in VIEWPOINTS:
        one = view(path, settings, viewpoint, frames)
        start, watch.spent_s = cpu_s(), 0.0
        write_pack(one, folder / "pack.parquet")
        shaded, traced = cpu_s() - start, watch.spent_s
        pack = read_pack(folder / "pack.parquet", one, one.trajectory())
        start, made = cpu_s(), 0
        for _, _, image in composed_images(one, pack, one.trajectory()):
            encode_png(image)
            made += 1
        composed = cpu_s() - start
        size = (folder / "pack.parquet").stat().st_size / frames / pixels**2
        print(
            f"{viewpoint}: Blender {traced / frames:.3f} CPU s/frame, {shaded / frames:.3f} with "
            f"separating and packing; {1e3 * composed / made:.1f} ms an image; "
            f"pack {size:.1f} bytes per pixel"
        )
        shading_s, image_s = shading_s + shaded, image_s + composed
        blender_s, count = blender_s + traced, count + made
    frames *= len(VIEWPOINTS)
    whole_s = PAPER_FRAMES * shading_s / frames + PAPER_IMAGES * image_s / count
    print(
        f"{floor}, {pixels} px, {count} images: Blender {blender_s / frames:.3f} CPU-s a "
        f"(simulation, viewpoint, frame), {1e3 * image_s / count:.1f} ms an image; "
        f"the paper's {PAPER_IMAGES} images: {whole_s / 60:.0f} CPU minutes, "
        f"{whole_s / 120:.0f} minutes on 2 cores"
    )


def long_process(folder: Path, pixels: int, frames: int) -> None:
    """Print memory and open files of one process that renders many frames."""
    settings = RenderSettings(pixels=pixels, textures=TEXTURES[:2], frames="all")
    path = folder / "m00_f0100_r00.parquet"
    write_trajectory(path, Trajectory(**synthetic_cloth.motion(frames, n=41)))

    def watched(shots):
        for number, shot in enumerate(shots):
            if number % 50 == 0:
                print(f"frame {number}: {resident_mb():.0f} MiB, {open_files()} files", flush=True)
            yield shot

    render_shard(view(path, settings, "calibrated", frames), folder / "x.parquet", progress=watched)
    print(f"after {frames} frames: {resident_mb():.0f} MiB, {open_files()} files")


def main() -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pixels", type=int, default=112)
    parser.add_argument("--images", type=int, default=2000)
    parser.add_argument("--floor", default="matte")
    parser.add_argument("--long", type=int, metavar="FRAMES", help="one process of many frames")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        if chosen.long:
            long_process(Path(name), chosen.pixels, chosen.long)
        else:
            cost(Path(name), chosen.pixels, chosen.images, chosen.floor)


if __name__ == "__main__":
    main()
