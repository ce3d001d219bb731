"""Duration of an audit of a large release, and whether it finds planted faults.

    python benchmarks/audit.py --size-gb 1 --jobs 2

Makes a release of the wanted size whose shards have the shape of real ones (112 pixels, drawn
images with noise, so that a PNG has a real one's size), audits it untouched, then plants
alterations one by one and audits again.
"""

import argparse
import contextlib
import resource
import shutil
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from support import synthetic_chain, synthetic_videos

from slipstitch.dataset.audit.auditing import audit_release
from slipstitch.dataset.audit.findings import Kind
from slipstitch.dataset.release.assembly import write_release
from slipstitch.design.grid import simulations, textures, viewpoints

PIXELS = 112
FRAMES = 30
VIEWS, TEXTURES = 3, 8
PLANTED = ("one bit", "one pixel", "two shards swapped", "a shard dropped", "a shard more")


def release_config(size_gb: float, image_bytes: float):
    """A grid whose images are about as many gigabytes; the paper's views, textures and frames."""
    videos = size_gb * 1e9 / image_bytes / FRAMES
    replicates = max(2, round(videos / (2 * 4 * VIEWS * TEXTURES)))
    return synthetic_chain.config(
        grid={
            "materials": ["gray-interlock", "ivory-rib-knit"],
            "frictions": [0.1, 0.3, 0.6, 1.0],
            "replicates": replicates,
        },
        simulation={"frames": 300, "vertices_per_side": 11},
        sample={"frames": FRAMES},
        render={
            "pixels": PIXELS,
            "viewpoints": ["calibrated", "frontal", "side"],
            "textures": [
                "stripes", "checks", "tartan", "dots", "houndstooth", "floral", "denim", "linen",
            ],
        },
        release={"shard_mb": 100.0},
    )  # fmt: skip


def rendered_like(seed: int) -> bytes:
    """PNG of a drawn image with a noise that makes it as large as a rendered one."""
    random = np.random.default_rng(seed)
    image = synthetic_videos.draw(PIXELS, random.uniform(), 0.3, 0.5, seed % 3, seed % 2)
    grey = random.normal(0, 2.0, (PIXELS, PIXELS, 1))
    noise = grey + random.normal(0, 0.7, image.shape)
    noisy = np.clip(image + noise, 0, 255).astype(np.uint8)
    return cv2.imencode(".png", noisy, [cv2.IMWRITE_PNG_COMPRESSION, 3])[1].tobytes()


def write_shards(config, folder: Path) -> list[Path]:
    """Shards as the render stage lays them out; the simulations share their images."""
    views, names = viewpoints(config), textures(config)
    frames = range(0, config.simulation.frames, config.simulation.frames // FRAMES)
    bank = [rendered_like(seed) for seed in range(FRAMES * len(names) * len(views))]
    folder.mkdir(parents=True)
    paths = []
    for one in simulations(config):
        for v, view in enumerate(views):
            rows = [
                {
                    "simulation": one.id,
                    "texture": texture["id"],
                    "viewpoint": view["id"],
                    "frame": frame,
                    "time_s": frame / config.simulation.frame_rate_hz,
                    "stage_x_m": 0.0,
                    "image": {"bytes": bank[(v * len(names) + t) * FRAMES + k], "path": None},
                }
                for t, texture in enumerate(names)
                for k, frame in enumerate(frames)
            ]
            paths.append(folder / f"{one.id}_{view['id']}.parquet")
            pq.write_table(pa.Table.from_pylist(rows, schema=synthetic_videos.SCHEMA), paths[-1])
    return paths


def audited(release: Path, jobs: int) -> tuple:
    """The audit, its wall and its CPU seconds."""
    before = resource.getrusage(resource.RUSAGE_SELF)
    start = time.perf_counter()
    audit = audit_release(release, jobs=jobs)
    wall = time.perf_counter() - start
    after = resource.getrusage(resource.RUSAGE_SELF)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return audit, wall, cpu


def change_pixel(path: Path, row: int) -> None:
    """Change one pixel by one and write the shard anew."""
    table = pq.read_table(path)
    rows = table["image"].to_pylist()
    pixels = cv2.imdecode(np.frombuffer(rows[row]["bytes"], np.uint8), cv2.IMREAD_COLOR)
    pixels[50, 60, 0] ^= 1
    rows[row]["bytes"] = cv2.imencode(".png", pixels)[1].tobytes()
    place = table.schema.get_field_index("image")
    column = pa.array(rows, table.schema.field("image").type)
    pq.write_table(table.set_column(place, "image", column), path)


def plant(release: Path, name: str, shards: list[Path]):
    """Plant an alteration; return how to undo it and the kind and place that must be found."""
    first, second, strange = shards[0], shards[-1], "data/strange.parquet"
    aside = release.parent / "aside"
    aside.mkdir(exist_ok=True)

    def put_back():
        for path in (first, second):
            if (aside / path.name).exists():
                shutil.copyfile(aside / path.name, path)
        (release / strange).unlink(missing_ok=True)
        shutil.rmtree(aside)

    for path in (first, second):
        shutil.copyfile(path, aside / path.name)
    place = first.relative_to(release).as_posix()
    if name == "one bit":
        content = bytearray(first.read_bytes())
        content[len(content) // 2] ^= 1
        first.write_bytes(content)
        return put_back, Kind.ALTERED, place
    if name == "one pixel":
        change_pixel(first, 17)
        return put_back, Kind.ALTERED, place
    if name == "two shards swapped":
        shutil.copyfile(aside / second.name, first)
        shutil.copyfile(aside / first.name, second)
        return put_back, Kind.ALTERED, place
    if name == "a shard dropped":
        first.unlink()
        return put_back, Kind.MISSING, place
    shutil.copyfile(first, release / strange)
    return put_back, Kind.UNEXPLAINED, strange


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size-gb", type=float, default=1.0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--keep", type=Path, help="folder for the release, kept")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    synthetic_videos.write_shards = write_shards
    config = release_config(arguments.size_gb, len(rendered_like(0)))
    with contextlib.ExitStack() as stack:
        folder = arguments.keep or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        folder.mkdir(parents=True, exist_ok=True)
        release = folder / "release"
        if not release.exists():
            print(f"{len(simulations(config))} simulations", file=sys.stderr)
            results = synthetic_chain.write(config, folder)
            start = time.process_time()
            done = write_release(config, results, release, ROOT)
            print(f"release: {done.images} images, {time.process_time() - start:.1f} CPU s")
            shutil.rmtree(results)
        audit, wall, cpu = audited(release, arguments.jobs)
        size = audit.numbers["bytes"] / 1e9
        print(
            f"untouched: {audit.verdict}, {len(audit.findings)} findings; "
            f"{size:.2f} GB, {audit.numbers['images']} images, {wall:.1f} s, {cpu:.1f} CPU s, "
            f"{arguments.jobs} threads"
        )
        for path in release.rglob("*"):
            path.chmod(path.stat().st_mode | 0o200)
        shards = sorted((release / "data").iterdir())
        for name in PLANTED:
            put_back, kind, place = plant(release, name, shards)
            audit, wall, cpu = audited(release, arguments.jobs)
            found = any(one.kind is kind and one.where == place for one in audit.findings)
            print(f"{name}: {'found' if found else 'MISSED'}, {wall:.1f} s, {cpu:.1f} CPU s")
            put_back()
        audit, wall, cpu = audited(release, arguments.jobs)
        print(f"put back: {audit.verdict}, {wall:.1f} s, {cpu:.1f} CPU s")


if __name__ == "__main__":
    main()
