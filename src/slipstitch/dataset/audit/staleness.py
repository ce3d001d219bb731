"""What the current code and configuration would change; the actual content of a commit."""

import functools
import re
import subprocess
import tempfile
import zipfile
from collections import defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path

from slipstitch.base.provenance.code import PACKAGE, RESULT_PACKAGES, installed_version
from slipstitch.config import Config
from slipstitch.dataset.audit.contents import Contents
from slipstitch.dataset.audit.findings import Kind
from slipstitch.dataset.release.currency import catalogue_changes, config_changes, current_digest
from slipstitch.dataset.release.records import Artefact
from slipstitch.physics.simulation.convergence import MEASURED, study_digest


def check_staleness(contents: Contents, config: Config | None) -> None:
    """Note STALE stages: of other code, catalogue, study, or values than `config` has."""
    touched: dict[tuple[str, str], set[str]] = defaultdict(set)
    study = study_digest()
    for artefact in contents.made():
        reasons = [*other_code(artefact)]
        if quoted_study(artefact) not in (None, study):
            reasons.append("it quotes the verdict of another convergence study than today's")
        reasons += [f"the catalogue has changed: {one}" for one in catalogue_changes(artefact)]
        changes = config_changes(artefact, config, contents.calibrated) if config else []
        reasons += [f"its configuration has changed: {one}" for one in changes]
        for reason in reasons:
            touched[artefact.stage, reason].update(contents.clips_of(artefact.path))
    own = contents.release.get("provenance", {}).get("code_digest")
    if own is not None and own != current_digest("release"):
        touched["release", "its code has changed"] = set()
    for (stage, reason), clips in sorted(touched.items()):
        contents.find(Kind.STALE, stage, reason, sorted(clips))


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


def check_commits(contents: Contents, checkout: Path) -> None:
    """Note BROKEN where a commit that records name holds other code, or another study, than they.

    Commits that cannot be looked at are remarked.
    """
    claims: dict[str, dict[tuple, list[Artefact]]] = defaultdict(lambda: defaultdict(list))
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
        contents.remarks.append(
            f"made with uncommitted changes: {', '.join(sorted(dirty))}; their code is only "
            "available in code/"
        )
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
        others = [one for one in artefacts if quoted_study(one) not in (None, study)]
        odd = []
        if current_digest(stage, source, dict(versions)) != digest:
            odd.append((artefacts, f"other code of {stage} than the records"))
        if others:
            odd.append((others, "another convergence study than is quoted"))
        for of_odd, what in odd:
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
