"""Bad inputs for every reader, and what a reader may do with them: return, or say one clean error.

An input is a good file of the right kind with bytes flipped, cut out, doubled, moved, or replaced
by words that have broken other programs.
"""

import contextlib
import io
import json
import random
import resource
import shutil
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import torch
import yaml

from slipstitch.base.errors import SlipstitchError
from slipstitch.base.provenance import read_provenance, start_clock
from slipstitch.config import load_config
from slipstitch.config.catalogue import VIEWPOINTS
from slipstitch.config.load import calibrated_settings, read_mapping, resolve_config
from slipstitch.config.simulation import BASE, KEYS
from slipstitch.criticise.case import read_case
from slipstitch.criticise.prediction import read_verdict
from slipstitch.dataset.audit.auditing import audit_release
from slipstitch.dataset.manifest import read_manifest
from slipstitch.dataset.release.assembly import write_release
from slipstitch.dataset.release.records import read_artefact
from slipstitch.dataset.videos import read_shard, read_videos
from slipstitch.design.grid import sampled_frames
from slipstitch.film import board
from slipstitch.film.captures_table import read_captures, read_references
from slipstitch.film.slip_angles import estimate, read_angles
from slipstitch.film.stage_video import read_stage_video
from slipstitch.images.camera import pose
from slipstitch.images.camera_file import read_camera_file
from slipstitch.images.encoding import decode_image
from slipstitch.images.image_shards import read_images
from slipstitch.images.textures import _read as read_texture
from slipstitch.learning.checkpoint import Progress, load_checkpoint, save_checkpoint
from slipstitch.learning.evaluation.trained import Trained
from slipstitch.learning.instrument.measuring import load_instrument, save_instrument
from slipstitch.learning.lrcn import LRCN, load_model, save_model
from slipstitch.physics.calibration.calibration import read_sweeps
from slipstitch.physics.calibration.sweep import sweep_inputs, variations
from slipstitch.physics.friction_law.extended_model import read_extended_model
from slipstitch.physics.simulation.trajectory import read_trajectory
from slipstitch.report.cost import benchmarks
from slipstitch.report.results import Results
from slipstitch.report.status import status
from support import analytic_stage, synthetic_chain, synthetic_results
from support.models import untrained_instrument

Found = Iterator[tuple[str, Path, Callable[[], object]]]
ROOT = Path(__file__).parents[2]
TIME_LIMIT_S = 10.0
MEMORY_LIMIT_BYTES = 2 * 2**30

WORDS = [
    b"", b"\x00", b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\x80", b"\xef\xbb\xbf", b"\r", b"\n",
    b"NaN", b"Infinity", b"-Infinity", b"1e999", b"-1", b"0", b"999999999999999999999", b"1e-400",
    b"null", b"true", b"[]", b"{}", b"[[[[[[[[[[[[", b'"', b"'", b",", b";", b":", b"\t", b"- ",
    b"&a [*a]", b"*a", b"!!python/object/apply:os.system [ls]", b"<<: *a", b"=cmd|' /C calc'!A0",
    b"../../../etc/passwd", b"/dev/zero", b"%s%n%d", b"{0.__class__}", b"PAR1", b"\x89PNG",
    "µ\u202e\u0000 ".encode(), b"0x10", b"1_000", b"1,5", b"yes", b"2026-13-45", b"x" * 70_000,
]  # fmt: skip

ODD = [None, True, -1, 0, 1e308, -1e308, 10**30, "", "x", "nan", "\0", [], {}, [[]], {"a": 1}]


@dataclass(frozen=True)
class Reader:
    """A reader under test: `read` reads `target`, which is spoilt, with whatever belongs to it."""

    name: str
    target: Path
    read: Callable[[], object]


def mutated(content: bytes, chance: random.Random) -> bytes:
    """A spoilt copy."""
    spoilt = bytearray(content)
    for _ in range(chance.choice((1, 1, 1, 2, 4, 16))):
        place = chance.randrange(len(spoilt) + 1)
        end = min(len(spoilt), place + chance.choice((1, 4, 64, 4096)))
        how = chance.randrange(7)
        if how == 0 and spoilt:
            spoilt[min(place, len(spoilt) - 1)] ^= 1 << chance.randrange(8)
        elif how in (1, 6):
            del spoilt[place : end if how == 1 else None]
        elif how in (2, 4):
            spoilt[place:place] = spoilt[place:end] if how == 2 else chance.choice(WORDS)
        else:
            spoilt[place:end] = chance.choice(WORDS) if how == 3 else chance.randbytes(end - place)
    return bytes(spoilt) if chance.random() > 0.02 else chance.randbytes(chance.randrange(2000))


def structured(content: bytes, chance: random.Random) -> bytes | None:
    """A copy of JSON or YAML with one value replaced by an odd one; None if it is neither."""
    try:
        data = yaml.safe_load(content) if content[:1] not in b"{[" else json.loads(content)
    except (ValueError, yaml.YAMLError):
        return None
    places = []

    def walk(value):
        if isinstance(value, dict | list) and len(places) < 5000:
            for key, item in value.items() if isinstance(value, dict) else enumerate(value):
                places.append((value, key))
                walk(item)

    walk(data)
    if not places:
        return None
    (holder, key), odd = chance.choice(places), chance.choice(ODD)
    if isinstance(holder, dict) and chance.random() < 0.3:
        del holder[key]
    else:
        holder[key] = odd
    return json.dumps(data).encode()


def spoil(content: bytes, chance: random.Random) -> bytes:
    """One bad input from a good one."""
    if chance.random() < 0.5 and (odd := structured(content, chance)) is not None:
        return odd
    return mutated(content, chance)


def readers(folder: Path) -> list[Reader]:
    """Every reader with a good file of its own in `folder`."""
    config = synthetic_chain.config()
    results = synthetic_chain.write(config, folder)
    synthetic_results.write_train(results)
    synthetic_results.write_evaluate(config, results)
    synthetic_results.write_benchmarks(config, results)
    others = folder / "others"
    others.mkdir()
    found = [
        *_configurations(others), *_tables(config, results), *_networks(config, others),
        *_pictures(others), *_measuring(others), *_cases(others), *_report(config, results),
        *_status(results), *_release(config, folder),
    ]  # fmt: skip
    for _, _, read in found:
        read()  # what is spoilt is good before
    return [Reader(*one) for one in found]


def _configurations(folder: Path) -> Found:
    path, json_path, model = (folder / f"config.{kind}" for kind in ("yaml", "json", "model.yaml"))
    shutil.copy(ROOT / "config.yaml", path)
    json_path.write_text(load_config(path).model_dump_json())
    yield "configuration", path, lambda: load_config(path)
    yield "configuration in JSON", json_path, lambda: load_config(json_path)
    yield "words", path, lambda: resolve_config(read_mapping(path), words=True)
    law = {"coefficient": 0.4, "mechanisms": {"adhesion": {"adhesion": 0.8}}}
    bench = {"tilt_along_rad": 0.02, "mass_error": 0.1, "camera_scale": 1.02}
    content = {"causes": ["adhesion", "tilt"], "friction_law": {"face": law}, "bench": bench}
    model.write_text(yaml.safe_dump(content))
    yield "extended model", model, lambda: read_extended_model(model)


def _tables(config, results: Path) -> Found:
    trajectory = sorted((results / "simulate").glob("*.parquet"))[0]
    shard = sorted((results / "render").glob("m*.parquet"))[0]
    sample, frames = results / "sample", sampled_frames(config.simulation.frames, 5)
    yield "trajectory", trajectory, lambda: read_trajectory(trajectory)
    yield "record of a trajectory", trajectory, lambda: record_if_any(trajectory)
    yield "image shard", shard, lambda: read_shard(shard, frames)
    yield "shard for previews", shard, lambda: decoded(read_images(shard))
    yield "manifest", sample / "manifest.parquet", lambda: read_manifest(sample)
    yield "dataset", sorted(sample.glob("m0*.parquet"))[0], lambda: read_videos(sample)
    yield "manifest for training", sample / "manifest.parquet", lambda: read_videos(sample)
    calibration = results / "calibrate/calibration.json"
    yield "calibration", calibration, lambda: calibrated_settings(calibration)
    sweep = results / "sweep.json"
    of_sweep = config.calibrate, config.simulation
    trials = [
        {"key": key, "settings": tried, "inputs": sweep_inputs(key, *of_sweep), "runs": []}
        for key in (BASE, *KEYS)
        for tried in variations(key, *of_sweep)
    ]
    sweep.write_text(json.dumps(trials))
    yield "sweep", sweep, lambda: read_sweeps([sweep], config)
    yield "artefact of a release", shard, lambda: read_artefact("results/render/x.parquet", shard)


def record_if_any(path: Path) -> None:
    with contextlib.suppress(FileNotFoundError):  # as documented
        read_provenance(path)


def decoded(images: dict) -> None:
    for data in (data for of_frame in images.values() for data in of_frame.values()):
        decode_image(data, "image")


def _networks(config, folder: Path) -> Found:
    train = config.train.model_copy(update={"channels": [2, 4], "convolutions": [1, 1]})
    network = LRCN(train, 2, 16)
    card = {
        "network": "friction_baseline", "split": "by_video", "seed": 0, "target": "friction",
        "settings": train.model_dump(mode="json"), "classes": [{"id": "f0100"}, {"id": "f0300"}],
        "condition_classes": [], "pixels": 16, "frames": 5,
    }  # fmt: skip
    models = folder / "models/by_video/friction_baseline/seed0"
    models.mkdir(parents=True)
    save_model(network.state_dict(), card, models)
    yield "weights", models / "model.safetensors", lambda: load_model(models)
    yield "model card", models / "model.json", lambda: load_model(models)
    trained = Trained(config, folder / "models")
    yield "models of a folder", models / "model.json", trained.load
    optimizer = torch.optim.Adadelta(network.parameters())
    path = folder / "checkpoint.safetensors"
    save_checkpoint(path, {"a": 1}, Progress(), network, optimizer, start_clock())
    yield "checkpoint", path, lambda: load_checkpoint(path, {"a": 1}, network, optimizer)


def _pictures(folder: Path) -> Found:
    image = np.random.default_rng(0).integers(0, 255, (64, 64, 3), np.uint8)
    for suffix in ("png", "jpg", "bmp", "tiff", "webp"):
        path = folder / f"picture.{suffix}"
        cv2.imwrite(str(path), image)
        yield f"picture ({suffix})", path, lambda path=path: board.read_image(path)
        yield f"texture ({suffix})", path, lambda path=path: read_texture(path)
    for suffix, code in (("mp4", "mp4v"), ("avi", "MJPG")):
        path = analytic_stage.write_avi(folder / f"film.{suffix}", [image] * 5, code)
        yield f"film ({suffix})", path, lambda path=path: list(board._frames(path))
    camera = analytic_stage.camera_file(analytic_stage.LENS, folder / "camera.json")
    yield "camera file", camera, lambda: read_camera_file(camera)


def _measuring(folder: Path) -> Found:
    """What `measure` and `capture` read: films, instruments, tables."""
    lens = analytic_stage.lens_camera(*pose(VIEWPOINTS["calibrated"]), size=(160, 120))
    bench = analytic_stage.Bench(lens)
    times = np.concatenate([np.arange(0, 6, 0.1), np.arange(6, 10, 0.5)])
    images = [bench.image(max(0.0, time_s - 2.6)) for time_s in times]
    _, schedule = analytic_stage.protocol(20, 4, 32)
    for suffix in ("mp4", "mkv"):
        film = folder / f"stage.{suffix}"
        analytic_stage.write_video(film, images, times)
        for name, start_s in (("from a stated start", 2.6), ("start found", None)):
            read = partial(read_stage_video, film, lens, schedule, start_s=start_s)
            yield f"film of a stage ({suffix}, {name})", film, read
    yield from _instruments(folder / "instrument")
    captures, reference, angles = (
        folder / f"{name}.csv" for name in ("captures", "reference", "angles")
    )
    analytic_stage.camera_file(lens, folder / "bench.json")
    captures.write_text(
        "video,material,substrate,repeat,mu_ref,mu_ref_error,reflective,camera\n"
        "stage.mp4,denim,glass,1,0.31,0.02,no,bench.json\n"
        "stage.mkv,denim,glass,2,0.31,0.02,no,bench.json\n"
    )
    reference.write_text("material,substrate,mu,error\ndenim,glass,0.31,0.02\n")
    rows = [f"denim,glass,p{n},warp,{n},{17 + n / 3:.2f},0.2" for n in range(4)]
    title = "material,substrate,position,orientation,repeat,angle_deg,bench_error_deg"
    angles.write_text("\n".join([title, *rows]) + "\n")
    yield "captures", captures, lambda: read_captures(captures)
    yield "captures with references", captures, lambda: read_captures(captures, reference)
    yield "references", reference, lambda: read_references(reference)
    yield "slip angles", angles, lambda: [estimate(one) for one in read_angles(angles)]


def _instruments(folder: Path) -> Found:
    folder.mkdir()
    save_instrument(untrained_instrument(frames=4, channels=[4, 4], features=8), folder)
    for name in ("instrument.safetensors", "instrument.json"):
        yield f"instrument, {name}", folder / name, lambda: load_instrument(folder)


def _cases(folder: Path) -> Found:
    cases = ROOT / "data/cases"
    for case in sorted(path for path in cases.iterdir() if path.is_dir()):
        copy = folder / case.name
        shutil.copytree(case, copy)
        for path in sorted(path for path in copy.rglob("*") if path.is_file()):
            yield f"case {path.relative_to(folder)}", path, lambda copy=copy: read_case(copy)
    verdict = folder / "verdict.json"
    model = {
        "causes": ["tilt"], "parameters": ["mu"], "values": [0.3], "covariance": [[0.01]],
        "scatter": {"incline": [0.01, 0.01, 1.0]},
    }  # fmt: skip
    verdict.write_text(json.dumps({"models": {"null": {**model, "causes": []}, "extended": model}}))
    yield "verdict", verdict, lambda: read_verdict(verdict)


def _report(config, results: Path) -> Found:
    found = Results(results, config)
    history = sorted((results / "train").rglob("history.csv"))[0]
    table = sorted((results / "benchmarks").rglob("*.tsv"))[0]
    yield "predictions", results / "evaluate/predictions.parquet", found.predictions
    yield "training history", history, found.histories
    yield "benchmark table", table, lambda: benchmarks(results)
    yield "manifest for the report", results / "sample/manifest.parquet", found.manifest
    for name in ("evaluate/metrics.json", "evaluate/details.json", "calibrate/calibration.json"):
        yield f"{name} for the report", results / name, partial(found.json, name)


def _status(results: Path) -> Found:
    folder = results / "status"
    folder.mkdir()
    job = {"id": 1, "rule": "simulate_one", "output": ["results/simulate/a.parquet"]}
    job |= {"benchmark": "results/benchmarks/a.tsv", "needed": True}
    (folder / "plan.json").write_text(json.dumps({"jobs": [job]}))
    events = [
        {"event": "run", "time": 1.0, "pid": 1, "born": 1, "boot": "x"},
        {"event": "started", "time": 2.0, "job": 1},
        {"event": "failed", "time": 3.0, "job": 1, "rule": "r", "output": ["a"], "log": ["b"]},
        {"event": "end", "time": 4, "success": False, "own_cpu_s": 1, "jobs_cpu_s": 2},
    ]
    (folder / "journal.jsonl").write_text("".join(json.dumps(one) + "\n" for one in events))
    for name in ("plan.json", "journal.jsonl"):
        yield f"status, {name}", folder / name, lambda: status(results, 3)


def _release(config, folder: Path) -> Found:
    out = folder / "release"
    with contextlib.chdir(folder), contextlib.redirect_stderr(io.StringIO()):
        write_release(config, "results", out, ROOT)
    paths = [out / name for name in ("manifest.parquet", "SHA256SUMS", "records/release.json")]
    paths += [next((out / "data").glob("*.parquet")), next((out / "records").rglob("*.json"))]
    for path in paths:
        yield f"audit, {path.name}", path, lambda: audit_release(out, jobs=1)


def bad_input_is_answered(reader: Reader, content: bytes) -> str | None:
    """Read one bad input; what is wrong with the answer, or None.

    A reader may return, or raise what the command line shows as one line.
    """
    good = reader.target.read_bytes()
    reader.target.write_bytes(content)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    began = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            reader.read()
    except SlipstitchError as error:
        if not str(error).strip():
            return "an error without words"
    except MemoryError:
        pass  # one line, too; the limit below says how much was tried
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        return f"{type(error).__name__} in {Path(place.filename).name}:{place.lineno}: {error}"
    finally:
        reader.target.write_bytes(good)
    took_s = time.process_time() - began  # not of a busy machine
    grown = 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
    if took_s > TIME_LIMIT_S:
        return f"took {took_s:.0f} s"
    return f"took {grown / 2**30:.1f} GiB" if grown > MEMORY_LIMIT_BYTES else None
