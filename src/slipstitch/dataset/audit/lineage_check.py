"""Tracing every clip to its origin, recomputing its labels, and what today's code would change.

Records are compared with each other; labels, times, stage positions and splits are recomputed from
configuration and seed. Both find accidents and careless changes; only a signature finds a release
whose records were all rewritten to agree.
"""

import functools
import re
import subprocess
import tempfile
import zipfile
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from slipstitch.base.errors import BadInput, first_line
from slipstitch.base.project import installed_version
from slipstitch.base.provenance import file_digest
from slipstitch.base.provenance.code import PACKAGE, RESULT_PACKAGES
from slipstitch.config import Config
from slipstitch.config.catalogue import FABRICS_FILE
from slipstitch.dataset.audit.contents import Contents
from slipstitch.dataset.audit.files import Shard
from slipstitch.dataset.audit.findings import Kind
from slipstitch.dataset.manifest import MANIFEST, dataset_digest, video_labels
from slipstitch.dataset.release import currency, records
from slipstitch.dataset.release.manifest import PREFIX, parts, sampled_rows, split_columns
from slipstitch.design.grid import sampled_frames
from slipstitch.design.stage_path import StagePath
from slipstitch.physics.fabric import fabric_digest
from slipstitch.physics.simulation.convergence import MEASURED, study_digest

_STAGE_TOLERANCE_M = 1e-9


def check_lineage(contents: Contents, shards: Mapping[str, Shard]) -> None:
    """Follow every clip, and remark comparisons that cannot be made."""
    if not contents.rows:
        contents.broken(MANIFEST, "no clip can be traced without it")
        return
    _check_links(contents)
    _check_sampled(contents)
    if contents.release:
        stated, sums = set(contents.release["files"]), set(contents.sums) - {records.RELEASE_RECORD}
        for name in stated ^ sums:
            lists = ("records/release.json", "SHA256SUMS")
            there, lacking = lists if name in stated else lists[::-1]
            contents.broken(name, f"listed in {there}, but not in {lacking}")
    sources = contents.folder / currency.SOURCES
    if (contents.folder / currency.PACKAGE_SOURCES / "dataset").is_dir():
        _check_sources(contents, sources)
    elif sources.is_dir():
        older = "code/src is of an older version of Slipstitch: code digests not compared"
        contents.remarks.append(older)
    if (config := contents.config) is None:
        return
    for artefact in contents.made():
        if changes := _config_changes(contents, artefact, config):
            what = f"made with a configuration that differs from records/config.json: {changes[0]}"
            contents.broken(
                records.record_file(artefact.path), what, contents.clips_of(artefact.path)
            )
    changed = (
        one.stage
        for one in contents.made()
        if one.record.get("code_digest") != currency.current_digest(one.stage, None, one.versions)
        or currency.catalogue_changes(one)
    )
    if stale := sorted(set(changed)):
        contents.remarks.append(
            "labels, times, stage positions and splits are checked with code that has changed "
            f"since ({', '.join(stale)})"
        )
    _check_recomputed(contents, config, stale)
    _check_times(contents, config, shards)
    _check_rendered(contents)


def _config_changes(contents: Contents, artefact: records.Artefact, config: Config) -> list[str]:
    """As `currency.config_changes`; also where a calibration has settings that there are not."""
    try:
        return currency.config_changes(artefact, config, contents.calibrated)
    except BadInput as problem:
        return [f"settings of its calibration: {first_line(problem)}"]


def _check_links(contents: Contents) -> None:
    """Note records that are missing, or about other files than what was made from them says."""
    artefacts = contents.artefacts
    starts = {path for row in contents.rows for path in contents.behind(row)}
    starts |= {records.SAMPLED_MANIFEST} | ({records.VERIFICATION} & set(artefacts))
    for path in sorted(starts):
        artefact = artefacts.get(path)
        where, clips = records.record_file(path), contents.clips_of(path)
        if artefact is None:
            contents.broken(where, f"no readable record of {path}", clips)
            continue
        if records.is_ours(path) and artefact.provenance is None:
            contents.broken(where, "does not state its origin", clips)
        if records.is_carried(artefact):
            carried = contents.folder / records.carried_file(path)
            if carried.is_file() and file_digest(carried) != artefact.sha256:
                what = f"not the file described by {where}"
                contents.broken(records.carried_file(path), what, clips)
        for name, digest in artefact.inputs.items():
            if name in artefacts and artefacts[name].sha256 != digest:
                other = records.record_file(name)
                what = f"was made from a {name} other than the one described by {other}"
                touched = min(contents.clips_of(name), clips, key=len)
                contents.broken(where, what, touched)
    manifest = artefacts.get(records.SAMPLED_MANIFEST)
    for row in contents.rows:
        if manifest and f"results/sample/{row['sampled_file']}" not in manifest.inputs:
            what = f"the manifest was not made from {row['sampled_file']}"
            contents.broken(records.record_file(records.SAMPLED_MANIFEST), what, [row["video"]])
        if not (contents.of_stage(row, "simulate") and contents.of_stage(row, "render")):
            what = f"{row['video']}: its rendering or simulation is missing"
            contents.broken(MANIFEST, what, [row["video"]])
    for path in set(artefacts) - starts:
        contents.broken(records.record_file(path), "no clip depends on the file that it describes")


def _check_sources(contents: Contents, sources: Path) -> None:
    """Compare records with the sources that the release carries."""
    for artefact in contents.made():
        where, clips = records.record_file(artefact.path), contents.clips_of(artefact.path)
        digest = artefact.record.get("code_digest")
        if digest != currency.current_digest(artefact.stage, sources, artefact.versions):
            what = f"its code digest is not that of {artefact.stage} in code/src at its versions"
            contents.broken(where, what, clips)
        for name, digest in currency.recorded_entries(artefact).get("fabrics", {}).items():
            if digest != _carried_fabric(sources, name):
                what = f"was made with a fabric {name} that differs from code/src"
                contents.broken(where, what, clips)
    digest = contents.release.get("provenance", {}).get("code_digest")
    if contents.release and digest != currency.current_digest("release", sources):
        contents.broken(
            records.RELEASE_RECORD, "its code digest differs from that of release in code/src"
        )


def _carried_fabric(sources: Path, name: str) -> str | None:
    """Digest of a fabric as the release's own sources have it; None if they do not."""
    try:
        return fabric_digest(name, sources / "slipstitch/config" / FABRICS_FILE.name)
    except BadInput:
        return None


def _check_sampled(contents: Contents) -> None:
    """Compare the manifest with the digest that the sampling stage noted of its rows."""
    record, rows = contents.artefacts.get(records.SAMPLED_MANIFEST), _sampled_rows(contents)
    if record and rows and dataset_digest(rows) != record.metadata.get("dataset_digest"):
        what = "labels, splits or pixel digests differ from those of the sampling stage"
        contents.broken(MANIFEST, f"{what} ({records.record_file(records.SAMPLED_MANIFEST)})")
    if not rows or dataset_digest(contents.rows) != contents.notes.get("dataset_digest"):
        contents.broken(MANIFEST, "its rows do not match their digest")


def _sampled_rows(contents: Contents) -> list[dict[str, Any]]:
    """The sampling stage's rows; none where the manifest does not have its columns."""
    try:
        return sampled_rows(contents.rows, contents.notes["sampled_columns"])
    except (KeyError, TypeError):
        return []


def _check_recomputed(contents: Contents, config: Config, stale: Collection[str]) -> None:
    """Compare labels and splits with what configuration and seed determine."""
    try:
        expected = video_labels(config)
    except BadInput as error:
        contents.broken("records/config.json", f"the splits cannot be drawn: {error}")
        return
    rows = _sampled_rows(contents)
    for row in rows:
        for name, value in expected.get(row["video"], {}).items():
            if name in row and not (name.startswith(PREFIX) and "sample" in stale):
                _compare(contents, row, name, value, "the configuration gives")
    if odd := sorted(set(expected) ^ set(contents.clips)):
        what = f"{odd[0]}: not in the configured grid"
        if odd[0] in expected:
            what = f"the clip {odd[0]} of the grid is missing ({len(odd)} differ from the grid)"
        contents.broken(MANIFEST, what, sorted(set(odd) & set(contents.clips)))
    if rows and "sample" not in stale:
        splits = split_columns(rows, config)
        columns = {PREFIX + name: sides for name, sides in splits.items()}
        for name, values in (columns | {"part": parts(splits)}).items():
            for row, value in zip(contents.rows, values, strict=True):
                _compare(contents, row, name, value, "redrawn")


def _compare(
    contents: Contents, row: Mapping[str, Any], name: str, expected: Any, which: str
) -> None:
    """Note a clip's column that has another value than expected."""
    if row.get(name) != expected:
        what = f"{row['video']}: {name} is {row.get(name)!r}, {which} {expected!r}"
        contents.broken(MANIFEST, what, [row["video"]])


def _check_times(contents: Contents, config: Config, shards: Mapping[str, Shard]) -> None:
    """Compare frame numbers, times and stage positions of the clips' images with the protocol."""
    frames = sampled_frames(config.simulation.frames, config.sample.frames_kept)
    times_s = frames / config.simulation.frame_rate_hz
    x_m, _ = StagePath(**dict(config.simulation.stage)).position_m(times_s)
    protocol = {"frame": frames, "time_s": times_s, "stage_x_m": x_m}
    for row in contents.rows:
        shard = shards.get(row["shard"])
        columns = (shard and shard.columns.get(row["video"])) or {}
        for name, values in protocol.items() if columns else ():
            found = np.array(columns.get(name), np.float64)
            if found.shape != values.shape or not (abs(found - values) <= _STAGE_TOLERANCE_M).all():
                what = f"{row['video']}: {name} differs from the protocol"
                contents.broken(row["shard"], what, [row["video"]])


def _check_rendered(contents: Contents) -> None:
    """Compare each clip's pose and floor with what its images were rendered with."""
    for row in contents.rows:
        for record in contents.of_stage(row, "render"):
            pose, floor = record.metadata.get("pose"), record.metadata.get("surroundings")
            told: dict[str, Any] = {}
            if isinstance(pose, Mapping):
                told |= {f"pose_{name}": value for name, value in pose.items()}
            if isinstance(floor, Mapping):
                told["floor"] = floor.get("floor")
                told |= {f"floor_{name}": floor.get(name) for name in ("reflectance", "roughness")}
            for name, value in told.items():
                _compare(contents, row, name, value, "rendered with")


def check_staleness(contents: Contents, config: Config | None) -> None:
    """Note STALE stages: of other code, catalogue, study, or values than `config` has."""
    touched: dict[tuple[str, str], set[str]] = defaultdict(set)
    study = study_digest()
    for artefact in contents.made():
        reasons = [*other_code(artefact)]
        if quoted_study(artefact) not in (None, study):
            reasons.append("it quotes the verdict of another convergence study than today's")
        reasons += [
            f"the catalogue has changed: {one}" for one in currency.catalogue_changes(artefact)
        ]
        changes = _config_changes(contents, artefact, config) if config else []
        reasons += [f"its configuration has changed: {one}" for one in changes]
        for reason in reasons:
            touched[artefact.stage, reason].update(contents.clips_of(artefact.path))
    own = contents.release.get("provenance", {}).get("code_digest")
    if own is not None and own != currency.current_digest("release"):
        touched["release", "its code has changed"] = set()
    for (stage, reason), clips in sorted(touched.items()):
        contents.find(Kind.STALE, stage, reason, sorted(clips))


def other_code(artefact: records.Artefact) -> Iterator[str]:
    """Why today's code would make something else: its sources, or what they are installed with."""
    made_by, versions = artefact.record["code_digest"], artefact.versions
    if made_by == currency.current_digest(artefact.stage):
        return
    same_sources = currency.current_digest(artefact.stage, None, versions)
    if same_sources is None:
        yield "the stage no longer exists"
    elif same_sources != made_by:
        yield "its code has changed"
    else:
        for package in sorted(RESULT_PACKAGES.values()):
            then, now = versions.get(package), installed_version(package)
            if then is not None and now is not None and then.split("+")[0] != now.split("+")[0]:
                yield f"it was made with {package} {then}; {now} is installed"


def quoted_study(artefact: records.Artefact) -> object:
    """SHA-256 of the table of verdicts that a trajectory quotes; None if it quotes none."""
    quoted = artefact.metadata.get("convergence")
    return quoted.get("table_sha256") if isinstance(quoted, Mapping) else None


def check_commits(contents: Contents, checkout: Path) -> None:
    """Note BROKEN where a commit that records name holds other code or study than they."""
    claims: dict[str, dict[tuple, list[records.Artefact]]] = defaultdict(lambda: defaultdict(list))
    dirty = set()
    for artefact in contents.made():
        record = artefact.record
        commit = record.get("git_commit")
        if not isinstance(commit, str) or record.get("git_dirty"):
            dirty.add(artefact.stage)
        else:
            versions = tuple(sorted(artefact.versions.items()))
            claims[commit][artefact.stage, record.get("code_digest"), versions].append(artefact)
    if dirty:
        names = ", ".join(sorted(dirty))
        what = f"made with uncommitted changes: {names}; their code is only available in code/"
        contents.remarks.append(what)
    for commit, stages in sorted(claims.items()):
        name, folder = f"commit {commit[:12]}", _unpacked(checkout, commit)
        if folder is None:
            contents.remarks.append(f"{name} is not in this checkout: code not compared")
        elif not Path(folder.name, "src", PACKAGE, "dataset").is_dir():
            contents.remarks.append(f"{name} is of an older version: code not compared")
        else:
            _check_claims(contents, name, stages, Path(folder.name, "src"))


def _check_claims(contents: Contents, commit: str, stages: dict, source: Path) -> None:
    study = study_digest(source / PACKAGE / "physics" / "simulation" / MEASURED.name)
    for (stage, digest, versions), artefacts in stages.items():
        odd = {}
        if currency.current_digest(stage, source, dict(versions)) != digest:
            odd[f"other code of {stage} than the records"] = artefacts
        if others := [one for one in artefacts if quoted_study(one) not in (None, study)]:
            odd["another convergence study than is quoted"] = others
        for what, of_odd in odd.items():
            clips = {clip for one in of_odd for clip in contents.clips_of(one.path)}
            contents.broken(stage, f"{commit} contains {what}", sorted(clips))


@functools.cache
def _unpacked(checkout: Path, commit: str) -> tempfile.TemporaryDirectory | None:
    """A folder, kept until the end, with ``src`` of a commit; None if the commit is not known."""
    if not re.fullmatch(r"[0-9a-f]{7,64}", commit):  # never an option or a revision range
        return None
    folder = tempfile.TemporaryDirectory()
    archive = Path(folder.name, "src.zip")
    command = ["git", "-C", str(checkout), "archive", f"--output={archive}", commit, "src"]
    try:
        subprocess.run(command, capture_output=True, timeout=60, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    # Unlike tarfile before Python 3.11.4, zipfile never writes outside the folder.
    with zipfile.ZipFile(archive) as packed:
        packed.extractall(folder.name)
    return folder
