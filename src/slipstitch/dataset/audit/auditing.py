"""The complete audit of a release, and the history of one of its clips."""

import json
import time
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from slipstitch.base.errors import BadInput
from slipstitch.base.page.wording import shortened
from slipstitch.base.project import PACKAGE
from slipstitch.config import Config
from slipstitch.config.catalogue import FABRICS_FILE
from slipstitch.dataset.audit.admission import limited_memory
from slipstitch.dataset.audit.contents import Contents, read_contents
from slipstitch.dataset.audit.files import check_files, read_shard
from slipstitch.dataset.audit.findings import NO_FORGER, Audit, Kind, sorted_findings
from slipstitch.dataset.audit.lineage_check import check_lineage
from slipstitch.dataset.audit.staleness import check_commits, check_staleness
from slipstitch.dataset.release.checksums import SIGNATURE, SUMS, verify
from slipstitch.dataset.release.currency import CALIBRATION, current_digest
from slipstitch.dataset.release.manifest import PREFIX
from slipstitch.dataset.release.records import (
    Artefact,
    carried_file,
    is_carried,
    is_ours,
    record_file,
)

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
        if artefact is None:
            lines += ["", f"{path}: NO RECORD, the chain is broken here"]
        else:
            lines += ["", *_artefact(contents, artefact, row)]
    lines += ["", *_fabric(contents, row)]
    return "\n".join(lines)


def _clip(contents: Contents, row: Mapping[str, Any]) -> list[str]:
    shard = contents.folder / row["shard"]
    if not shard.is_file():
        pixels = "the shard is missing"
    else:
        found = read_shard(shard).pixels.get(row["video"])
        same = found == row["pixels_sha256"]
        pixels = f"{'equal' if same else 'NOT equal'} to the decoded pixels"
        pixels += "" if same else f" ({found})"
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


def _artefact(contents: Contents, artefact: Artefact, row: Mapping) -> list[str]:
    record = artefact.provenance
    lines = [
        artefact.path,
        f"  record   {record_file(artefact.path)}",
        f"  SHA-256  {artefact.sha256}",
    ]
    if is_carried(artefact) and (contents.folder / carried_file(artefact.path)).is_file():
        lines.append(f"  carried  {carried_file(artefact.path)}")
    if record is None or not is_ours(artefact.path):
        return [*lines, "  external input: not made by a stage"]
    now = current_digest(artefact.stage)
    code = "the current code" if now == record["code_digest"] else "NOT the current code"
    commit = record.get("git_commit") or "unknown commit"
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
    if PurePosixPath(artefact.path).name == CALIBRATION:  # not the sweeps that it was chosen from
        lines.append(f"  says     {_checks(contents, artefact)}")
    for name in contents.inputs(artefact.path, row.get("viewpoint_id")):
        link, behind = "NO RECORD", contents.artefacts.get(name)
        if behind is not None:
            same = behind.sha256 == artefact.inputs[name]
            link = "the next" if same else "DIFFERENT from the next"
        lines.append(f"  from     {name} ({link})")
    return lines


def _checks(contents: Contents, artefact: Artefact) -> str:
    try:
        path = contents.folder / carried_file(artefact.path)
        checks = json.loads(path.read_text(encoding="utf-8"))["checks"]
        worst = max(checks, key=lambda check: check["error"] / (check["demand"] or 1.0))
    except (OSError, ValueError, KeyError, TypeError):
        return "checks: unreadable"
    return (
        f"{sum(check['met'] for check in checks)} of {len(checks)} checks against theory met; "
        f"the closest to its limit: {worst['name']}, error {worst['error']:.2e} of "
        f"{worst['demand']:.2e} allowed"
    )


def _short(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    return shortened(text, 400)


def _fabric(contents: Contents, row: Mapping[str, Any]) -> list[str]:
    """The measured fabric, as the carried sources have it, against today's."""
    name = row["material"]
    carried = f"code/src/slipstitch/config/{FABRICS_FILE.name}"
    try:
        then = json.loads((contents.folder / carried).read_text(encoding="utf-8"))["fabrics"][name]
    except (OSError, ValueError, KeyError, TypeError):
        return [f"fabric {name}: not in the release's sources"]
    now = json.loads(FABRICS_FILE.read_text(encoding="utf-8"))["fabrics"].get(name)
    same = "same as the current one" if now == then else "DIFFERENT from the current one"
    return [
        f"fabric {name} ({same})",
        f"  areal density {then['areal_density_kg_m2']} kg/m2; stretching and bending tables in "
        f"{carried}",
    ]


def audit_release(
    folder: Path,
    config: Config | None = None,
    expected: str | None = None,
    jobs: int = 2,
    signers: Path | None = None,
) -> Audit:
    """Audit a release; BadInput if the folder is no release, or cannot be read without harm.

    The code of today is compared anyway, a `config` where one is given; `expected` is the SHA-256
    that ``SHA256SUMS`` must have, as the publisher states it elsewhere; `jobs` is a number of
    threads, and `signers` says who may have signed it, see
    `slipstitch.dataset.release.checksums.verify`.
    """
    with limited_memory():
        return _audit(folder, config, expected, jobs, signers)


def _audit(
    folder: Path, config: Config | None, expected: str | None, jobs: int, signers: Path | None
) -> Audit:
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
    return Audit(
        release=contents.name,
        sums_sha256=contents.sums_sha256,
        numbers=numbers | cost,
        findings=sorted_findings(contents.findings),
        notes=contents.remarks,
        clips=contents.clips,
    )
