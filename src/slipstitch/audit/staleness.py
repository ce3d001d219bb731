"""What the current code and configuration would change; the actual content of a commit."""

import subprocess
import tarfile
import tempfile
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

from slipstitch.audit.contents import Contents
from slipstitch.audit.findings import Finding, Kind
from slipstitch.audit.lineage import Lineage
from slipstitch.config import Config
from slipstitch.release.currency import catalogue_changes, config_changes, current_digest
from slipstitch.release.records import is_ours


def check_staleness(contents: Contents, config: Config | None) -> list[Finding]:
    """Stages whose code or catalogue has changed, and records of other values than `config`.

    Parameters
    ----------
    contents : Contents
    config : Config or None
        Today's configuration; None to compare code and catalogue only.

    Returns
    -------
    list of Finding
        All of kind STALE, one a stage and reason.
    """
    lineage = Lineage(contents)
    touched: dict[tuple[str, str], set[str]] = defaultdict(set)
    for path, artefact in contents.artefacts.items():
        if artefact.provenance is None or not is_ours(path):
            continue
        now = current_digest(artefact.stage)
        if artefact.provenance.get("code_digest") != now:
            reason = "the stage no longer exists" if now is None else "its code has changed"
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


def check_commits(contents: Contents, checkout: Path) -> tuple[list[Finding], list[str]]:
    """Code digests of the records against the commits that they name, in a checkout's history.

    Returns
    -------
    findings : list of Finding
        BROKEN where a commit holds other code than the digest is of.
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
        if commit is None or record.get("git_dirty"):
            dirty.add(artefact.stage)
        else:
            claims[commit][artefact.stage, record.get("code_digest")].append(path)
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
            findings += _claims(Lineage(contents), commit, stages, Path(folder) / "src")
    return findings, notes


def _claims(lineage: Lineage, commit: str, stages: dict, source: Path) -> Iterator[Finding]:
    for (stage, digest), paths in stages.items():
        if current_digest(stage, source) != digest:
            clips = {clip for path in paths for clip in lineage.clips(path)}
            what = f"commit {commit[:12]} contains other code of {stage} than the records"
            yield Finding(Kind.BROKEN, stage, what, tuple(sorted(clips)))


def _extract(checkout: Path, commit: str, folder: Path) -> bool:
    """Put ``src`` of a commit into `folder`; False if the commit is not known."""
    if not commit.isalnum():  # never an option or a revision range
        return False
    archive = folder / "src.tar"
    command = ["git", "-C", str(checkout), "archive", f"--output={archive}", commit, "src"]
    try:
        if subprocess.run(command, capture_output=True, timeout=60).returncode != 0:
            return False
    except (OSError, subprocess.TimeoutExpired):
        return False
    with tarfile.open(archive) as tar:
        tar.extractall(folder, filter="data")
    return True
