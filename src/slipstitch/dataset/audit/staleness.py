"""What the current code and configuration would change; the actual content of a commit."""

import re
import subprocess
import tempfile
import zipfile
from collections import defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path

from slipstitch.base.provenance.code import PACKAGE, RESULT_PACKAGES, installed_version
from slipstitch.config import Config
from slipstitch.dataset.audit.contents import Contents, Lineage
from slipstitch.dataset.audit.findings import Finding, Kind
from slipstitch.dataset.release.currency import catalogue_changes, config_changes, current_digest
from slipstitch.dataset.release.records import Artefact, is_ours
from slipstitch.physics.simulation.convergence import MEASURED, study_digest


def check_staleness(contents: Contents, config: Config | None) -> list[Finding]:
    """Stages whose code, catalogue or study has changed, and records of other values than `config`.

    Returns
    -------
    list of Finding
        All of kind STALE, one a stage and reason.
    """
    lineage = Lineage(contents)
    touched: dict[tuple[str, str], set[str]] = defaultdict(set)
    study = study_digest()
    for path, artefact in contents.artefacts.items():
        if artefact.provenance is None or not is_ours(path):
            continue
        for reason in other_code(artefact):
            touched[artefact.stage, reason].update(lineage.clips(path))
        if quoted_study(artefact) not in (None, study):
            reason = "it quotes the verdict of another convergence study than today's"
            touched[artefact.stage, reason].update(lineage.clips(path))
        for change in catalogue_changes(artefact):
            reason = f"the catalogue has changed: {change}"
            touched[artefact.stage, reason].update(lineage.clips(path))
        if config is not None:
            for change in config_changes(artefact, config, contents.calibrated):
                reason = f"its configuration has changed: {change}"
                touched[artefact.stage, reason].update(lineage.clips(path))
    own = contents.release.get("provenance", {}).get("code_digest")
    if own is not None and own != current_digest("release"):
        touched["release", "its code has changed"].update(())
    return [
        Finding(Kind.STALE, stage, reason, tuple(sorted(clips)))
        for (stage, reason), clips in sorted(touched.items())
    ]


def other_code(artefact: Artefact) -> Iterator[str]:
    """Why today's code would make something else: its sources, or what they are installed with."""
    made_by, versions = artefact.record["code_digest"], artefact.versions
    if made_by == current_digest(artefact.stage):
        return
    same_sources = current_digest(artefact.stage, None, versions)
    if same_sources is None:
        yield "the stage no longer exists"
    elif same_sources != made_by:
        yield "its code has changed"
    else:
        for package in sorted(RESULT_PACKAGES.values()):
            then, now = versions.get(package), installed_version(package)
            if then is not None and now is not None and then.split("+")[0] != now.split("+")[0]:
                yield f"it was made with {package} {then}; {now} is installed"


def quoted_study(artefact: Artefact) -> object:
    """SHA-256 of the table of verdicts that a trajectory quotes; None if it quotes none."""
    quoted = artefact.metadata.get("convergence")
    return quoted.get("table_sha256") if isinstance(quoted, Mapping) else None


def check_commits(contents: Contents, checkout: Path) -> tuple[list[Finding], list[str]]:
    """Code digests of the records against the commits that they name.

    Returns
    -------
    findings : list of Finding
        BROKEN where a commit holds other code, or another convergence study, than the release
        says.
    notes : list of str
        Commits that could not be looked at.
    """
    claims: dict[str, dict[tuple, list[str]]] = defaultdict(lambda: defaultdict(list))
    notes = []
    dirty = set()
    for path, artefact in contents.artefacts.items():
        record = artefact.provenance
        if record is None or not is_ours(path):
            continue
        commit = record.get("git_commit")
        if not isinstance(commit, str) or record.get("git_dirty"):
            dirty.add(artefact.stage)
        else:
            versions = tuple(sorted(artefact.versions.items()))
            claims[commit][artefact.stage, record.get("code_digest"), versions].append(path)
    if dirty:
        notes.append(
            f"made with uncommitted changes: {', '.join(sorted(dirty))}; their code is only "
            "available in code/"
        )
    findings: list[Finding] = []
    for commit, stages in sorted(claims.items()):
        with tempfile.TemporaryDirectory() as folder:
            if not _extract(checkout, commit, Path(folder)):
                notes.append(f"commit {commit[:12]} is not in this checkout: code not compared")
                continue
            source = Path(folder) / "src"
            if not (source / PACKAGE / "dataset").is_dir():
                notes.append(f"commit {commit[:12]} is of an older version: code not compared")
                continue
            findings += _claims(Lineage(contents), commit, stages, source)
    return findings, notes


def _claims(lineage: Lineage, commit: str, stages: dict, source: Path) -> Iterator[Finding]:
    study = study_digest(source / PACKAGE / "physics" / "simulation" / MEASURED.name)
    for (stage, digest, versions), paths in stages.items():
        if current_digest(stage, source, dict(versions)) != digest:
            clips = {clip for path in paths for clip in lineage.clips(path)}
            what = f"commit {commit[:12]} contains other code of {stage} than the records"
            yield Finding(Kind.BROKEN, stage, what, tuple(sorted(clips)))
        other = [
            path for path in paths if quoted_study(lineage.artefacts[path]) not in (None, study)
        ]
        if other:
            clips = {clip for path in other for clip in lineage.clips(path)}
            what = f"commit {commit[:12]} contains another convergence study than is quoted"
            yield Finding(Kind.BROKEN, stage, what, tuple(sorted(clips)))


def _extract(checkout: Path, commit: str, folder: Path) -> bool:
    """Put ``src`` of a commit into `folder`; False if the commit is not known."""
    if not re.fullmatch(r"[0-9a-f]{7,64}", commit):  # never an option or a revision range
        return False
    archive = folder / "src.zip"
    command = ["git", "-C", str(checkout), "archive", f"--output={archive}", commit, "src"]
    try:
        subprocess.run(command, capture_output=True, timeout=60, check=True)
    except (OSError, subprocess.SubprocessError):
        return False
    # Unlike tarfile before Python 3.11.4, zipfile never writes outside the folder.
    with zipfile.ZipFile(archive) as packed:
        packed.extractall(folder)
    return True
