"""The complete audit of a release; the history of one of its clips, and the clip made again."""

import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq

from slipstitch.base.errors import BadInput, SlipstitchError
from slipstitch.base.page.wording import shortened
from slipstitch.base.project import PACKAGE
from slipstitch.base.provenance import read_metadata, write_json
from slipstitch.config import Config
from slipstitch.config.catalogue import FABRICS_FILE
from slipstitch.config.load import without_law
from slipstitch.dataset.audit.admission import limited_memory
from slipstitch.dataset.audit.contents import Contents, read_contents
from slipstitch.dataset.audit.files import check_files, decoded_shard
from slipstitch.dataset.audit.findings import NO_FORGER, Audit, Kind, sorted_findings
from slipstitch.dataset.audit.lineage_check import check_commits, check_lineage, check_staleness
from slipstitch.dataset.release import records
from slipstitch.dataset.release.checksums import SIGNATURE, SUMS, verify
from slipstitch.dataset.release.currency import current_digest
from slipstitch.dataset.release.manifest import PREFIX
from slipstitch.dataset.videos import decode, read_shard

_NO_LABELS = ("video", "pixels_sha256", "shard", "first_row", "frames", "pixels")


def find_clip(contents: Contents, clip: str) -> dict[str, Any]:
    """The clip's row of the manifest; BadInput if the release has no such clip."""
    row = contents.row_of.get(clip)
    if row is None:
        some = f"; ids look like {contents.clips[0]}" if contents.clips else ""
        raise BadInput(f"{contents.folder}: no clip {clip!r}{some}")
    return row


def explain(contents: Contents, clip: str) -> str:
    """The story as lines; BadInput if the release has no such clip."""
    row = find_clip(contents, clip)
    lines = [f"{clip}, a clip of {contents.name}", *_clip(contents, row)]
    for path in contents.behind(row):
        artefact = contents.artefacts.get(path)
        broken = [f"{path}: NO RECORD, the chain is broken here"]
        lines += ["", *(_artefact(contents, artefact, row) if artefact else broken)]
    return "\n".join([*lines, "", *_fabric(contents, row)])


def _clip(contents: Contents, row: Mapping[str, Any]) -> list[str]:
    shard = contents.folder / row["shard"]
    if not shard.is_file():
        pixels = "the shard is missing"
    elif (found := decoded_shard(shard).pixels.get(row["video"])) == row["pixels_sha256"]:
        pixels = "equal to the decoded pixels"
    else:
        pixels = f"NOT equal to the decoded pixels ({found})"
    labels, sides = [], []
    for name, value in row.items():
        if name.startswith(PREFIX):
            sides.append(f"{name.removeprefix(PREFIX)}: {value or 'not used'}")
        elif name not in _NO_LABELS and not name.startswith("sampled_"):
            labels.append(f"{name} {value}")
    last = row["first_row"] + row["frames"] - 1
    return [
        f"  images   {row['frames']} of {row['pixels']} px, {row['shard']} rows {row['first_row']} "
        f"to {last}",
        f"  pixels   SHA-256 {row['pixels_sha256']}, {pixels}",
        f"  labels   {'; '.join(labels)}",
        f"  splits   {'; '.join(sides)}",
    ]


def _artefact(contents: Contents, artefact: records.Artefact, row: Mapping) -> list[str]:
    record = artefact.provenance
    lines = [
        artefact.path,
        f"  record   {records.record_file(artefact.path)}",
        f"  SHA-256  {artefact.sha256}",
    ]
    carried = records.carried_file(artefact.path)
    if records.is_carried(artefact) and (contents.folder / carried).is_file():
        lines.append(f"  carried  {carried}")
    if record is None or not records.is_ours(artefact.path):
        return [*lines, "  external input: not made by a stage"]
    now = current_digest(artefact.stage)
    code = "the current code" if now == record["code_digest"] else "NOT the current code"
    commit = str(record.get("git_commit") or "unknown commit")
    changed = ", with uncommitted changes" if record.get("git_dirty") else ""
    lines += [
        f"  made by  slipstitch {artefact.stage}, code {record['code_digest'][:16]} ({code}), "
        f"commit {commit[:12]}{changed}",
        f"  on       {record.get('host_kind')}; {record.get('wall_s')} s, "
        f"{record.get('cpu_s')} CPU s",
        f"  with     {_short(artefact.versions)}",
        f"  seed     {record.get('seed')}",
        f"  config   {_short(record['config'])}",
    ]
    lines += [
        f"  says     {name}: {_short(value)}"
        for name, value in artefact.metadata.items()
        if name not in ("settings", "camera")
    ]
    if records.is_calibration(artefact.path):  # not the sweeps that it was chosen from
        lines.append(f"  says     {_checks(contents, artefact)}")
    for name in contents.inputs(artefact.path, row.get("viewpoint_id")):
        link, behind = "NO RECORD", contents.artefacts.get(name)
        if behind is not None:
            same = behind.sha256 == artefact.inputs[name]
            link = "the next" if same else "DIFFERENT from the next"
        lines.append(f"  from     {name} ({link})")
    return lines


def _checks(contents: Contents, artefact: records.Artefact) -> str:
    try:
        path = contents.folder / records.carried_file(artefact.path)
        checks = json.loads(path.read_text(encoding="utf-8"))["checks"]
        worst = max(checks, key=lambda check: check["error"] / (check["demand"] or 1.0))
        return (
            f"{sum(check['met'] for check in checks)} of {len(checks)} checks against theory met; "
            f"the closest to its limit: {worst['name']}, error {worst['error']:.2e} of "
            f"{worst['demand']:.2e} allowed"
        )
    except (OSError, ValueError, KeyError, TypeError):
        return "checks: unreadable"


def _short(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    return shortened(text, 400)


def _fabric(contents: Contents, row: Mapping[str, Any]) -> list[str]:
    """The measured fabric, as the carried sources have it, against today's."""
    name = row["material"]
    carried = f"code/src/slipstitch/config/{FABRICS_FILE.name}"
    try:
        then = json.loads((contents.folder / carried).read_text(encoding="utf-8"))["fabrics"][name]
        density = then["areal_density_kg_m2"]
    except (OSError, ValueError, KeyError, TypeError):
        return [f"fabric {name}: not in the release's sources"]
    now = json.loads(FABRICS_FILE.read_text(encoding="utf-8"))["fabrics"].get(name)
    same = "same as the current one" if now == then else "DIFFERENT from the current one"
    return [
        f"fabric {name} ({same})",
        f"  areal density {density} kg/m2; stretching and bending tables in {carried}",
    ]


@limited_memory()
def audit_release(
    folder: Path,
    config: Config | None = None,
    expected: str | None = None,
    jobs: int = 2,
    signers: Path | None = None,
) -> Audit:
    """Audit a release; BadInput if the folder is no release, or cannot be read without harm.

    The code of today is compared anyway, a `config` if given; `expected` is the SHA-256 that
    ``SHA256SUMS`` must have, `jobs` a number of threads, `signers` who may have signed
    (`checksums.verify`).
    """
    wall, cpu = time.perf_counter(), time.process_time()
    contents = read_contents(folder)
    if expected is not None and contents.sums_sha256 != expected.lower():
        what = f"is {contents.sums_sha256}, not the expected {expected.lower()}: another release"
        contents.find(Kind.ALTERED, SUMS, what, contents.clips)
    if signers is not None:
        signer, problem = verify(folder, signers)
        if problem is not None:
            contents.find(Kind.ALTERED, SIGNATURE, problem, contents.clips)
        else:
            contents.remarks.append(f"signed by {signer}")
    elif expected is None:
        contents.remarks.append(NO_FORGER)
    numbers, shards = check_files(contents, jobs)
    check_staleness(contents, config)
    check_lineage(contents, shards)
    check_commits(contents, PACKAGE.parents[1])
    cost = {
        "clips": len(contents.clips),
        "wall_s": round(time.perf_counter() - wall, 2),
        "cpu_s": round(time.process_time() - cpu, 2),
    }
    findings = sorted_findings(contents.findings)
    about = contents.name, contents.sums_sha256, numbers | cost
    return Audit(*about, findings, contents.remarks, contents.clips)


# How and beside what it ran; the trajectory's digest is of its times too.
_OF_THE_RUN = frozenset({"device", "simulated_at_once", "trajectory_sha256"})


@dataclass(frozen=True)
class Rebuilt:
    """A clip made again beside the released one."""

    clip: str
    same_motion: bool  # whether the simulation gave the same bits
    same_pixels: bool
    images_differing: int
    images: int
    largest_difference: int  # of a channel of a pixel, 0 ... 255
    psnr_db: float | None  # None if equal
    # What the records of the simulation and of the rendering tell otherwise
    differing: tuple[str, ...] = ()

    @property
    def same(self) -> bool:
        """Whether nothing differs."""
        return self.same_pixels and self.same_motion and not self.differing


def _run(*words: str) -> None:
    """Run a verb of Slipstitch; Blender wants a process of its own."""
    answer = subprocess.run(
        [sys.executable, "-m", "slipstitch", *words], capture_output=True, text=True
    )
    if answer.returncode:
        errors = answer.stderr.strip().splitlines()
        raise SlipstitchError(f"slipstitch {words[0]}: {errors[-1] if errors else 'failed'}")


def _configuration(contents: Contents, config: Config, folder: Path) -> Path:
    """The release's configuration, with files from outside taken from the release."""
    whole = config.model_dump(mode="json")
    simulation, render = whole["simulation"], whole["render"]
    files = {simulation["model"], render["camera"], *config.render.texture_files()} - {None}

    def taken_along(name: str | None) -> str | None:
        path = records.recorded_name(name, contents.artefacts) if name and name in files else None
        return str((contents.folder / records.carried_file(path)).resolve()) if path else name

    for section, key in ((simulation, "model"), (render, "camera")):
        section[key] = taken_along(section[key])
    for key in ("textures", "test_textures"):
        render[key] = [taken_along(name) for name in render[key]]
    write_json(folder / "config.json", whole)
    return folder / "config.json"


def rebuild(contents: Contents, clip: str) -> Rebuilt:
    """Render a clip again with the installed code, from simulations that are carried or made again.

    BadInput if the release lacks what it takes; SlipstitchError if a stage fails.
    """
    row = find_clip(contents, clip)
    stages = ("simulate", "render", "calibrate.calibration")
    simulated, rendered, calibrated = (contents.of_stage(row, stage) for stage in stages)
    of_view = [one for one in rendered if Path(one.path).stem.endswith(row["viewpoint_id"])]
    if contents.config is None or not (simulated and of_view and calibrated):
        raise BadInput(f"{contents.folder}: the records behind {clip} are not whole")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        config = _configuration(contents, contents.config, folder)
        shard = folder / "shard.parquet"
        # Of an interpolated film all simulations that its cloth is made of.
        trajectories = {one.path: folder / Path(one.path).name for one in simulated}
        for path, trajectory in trajectories.items():
            carried = contents.folder / records.carried_file(path)
            if carried.is_file():  # filmed again from the simulation that the release carries
                shutil.copyfile(carried, trajectory)
                continue
            _run(
                "simulate", "--config", str(config), "--simulation", trajectory.stem,
                "--calibration", str(contents.folder / records.carried_file(calibrated[0].path)),
                "--out", str(trajectory),
            )  # fmt: skip
        same_motion = all(
            records.rows_digest(trajectories[one.path]) == one.rows_sha256 for one in simulated
        )
        _run(
            "render", "--config", str(config),
            "--trajectory", str(folder / f"{row['simulation']}.parquet"),
            "--viewpoint", row["viewpoint_id"], "--out", str(shard),
        )  # fmt: skip
        table = pq.read_table(contents.folder / row["shard"], columns=["frame", "image"])
        table = table.slice(row["first_row"], row["frames"])
        videos = read_shard(shard, table["frame"].to_numpy())
        key = (row["simulation"], row["texture_id"], row["viewpoint_id"])
        if key not in videos:
            raise BadInput(f"{clip}: not among the {len(videos)} videos rendered again")
        again, released = (
            np.stack([decode(one["image"]["bytes"], clip, row["pixels"]) for one in images])
            for images in (videos[key], table.to_pylist())
        )
        differing = [*_differing(of_view[0], shard)]
        for one in simulated:
            differing += _differing(one, trajectories[one.path])
    return compare(clip, released, again, same_motion, tuple(differing))


def _differing(recorded: records.Artefact, made: Path) -> list[str]:
    """Entries of a record's metadata that a file made again has otherwise."""
    then, now = (_comparable(metadata) for metadata in (recorded.metadata, read_metadata(made)))
    return [f"{name} of {recorded.path}" for name, value in then.items() if now.get(name) != value]


def _comparable(metadata: Mapping[str, Any]) -> dict[str, Any]:
    """What must be the same in a file made again; not where the law lay, whose content must."""
    kept = {name: value for name, value in metadata.items() if name not in _OF_THE_RUN}
    if isinstance(kept.get("settings"), dict):
        kept["settings"] = without_law(kept["settings"])
    return kept


def compare(
    clip: str,
    released: np.ndarray,
    again: np.ndarray,
    same_motion: bool,
    differing: tuple[str, ...] = (),
) -> Rebuilt:
    """Compare two arrays of images, uint8 of equal shape; the rest as in `Rebuilt`."""
    difference = released.astype(np.int16) - again
    mean_square = float(np.mean(np.square(difference, dtype=np.float64)))
    return Rebuilt(
        clip=clip,
        same_motion=same_motion,
        same_pixels=not difference.any(),
        images_differing=int(difference.any(axis=(1, 2, 3)).sum()),
        images=len(released),
        largest_difference=int(np.abs(difference).max()),
        psnr_db=round(10 * np.log10(255**2 / mean_square), 2) if mean_square else None,
        differing=differing,
    )


def in_words(done: Rebuilt) -> str:
    """The comparison as a line."""
    motion = "the same motion, bit by bit" if done.same_motion else "ANOTHER MOTION"
    told = f"; its records TELL OTHERWISE: {', '.join(done.differing)}" if done.differing else ""
    if done.same_pixels:
        pixels = f"all {done.images} images have equal pixels"
    else:
        pixels = (
            f"{done.images_differing} of {done.images} images DIFFER, "
            f"by up to {done.largest_difference} of 255, {done.psnr_db} dB"
        )
    return f"{done.clip}: made again, {motion}; {pixels}{told}"
