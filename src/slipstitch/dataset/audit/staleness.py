"""What the current code and configuration would change; the actual content of a commit."""

import hashlib
import re
import subprocess
import tempfile
import zipfile
from collections import defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path

from slipstitch.base.provenance.code import PACKAGE, RESULT_PACKAGES, installed_version
from slipstitch.base.provenance.record import TRACKED
from slipstitch.config import Config
from slipstitch.dataset.audit.contents import Contents
from slipstitch.dataset.audit.findings import Finding, Kind
from slipstitch.dataset.audit.lineage import Lineage
from slipstitch.dataset.release.code import CODE
from slipstitch.dataset.release.currency import catalogue_changes, config_changes, current_digest
from slipstitch.dataset.release.records import Artefact, is_ours
from slipstitch.physics.simulation.convergence import MEASURED, study_digest


def check_staleness(contents: Contents, config: Config | None) -> list[Finding]:
    """Stages whose code, catalogue or study has changed, and records of other values than `config`.

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
    """Code digests of the records and the files in ``code/`` against the commits that they name.

    Parameters
    ----------
    contents : Contents
    checkout : path
        A checkout in whose history the commits are looked up.

    Returns
    -------
    findings : list of Finding
        BROKEN where a commit holds other code, or another convergence study, than the release
        says. STALE where the release names no commit and the checkout's own workflow is another.
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
            findings += _claims(Lineage(contents), commit, stages, Path(folder) / "src")
    return findings + copied_code(contents, checkout), notes


def copied_code(contents: Contents, checkout: Path) -> list[Finding]:
    """Files in ``code/`` against the release's commit; without one, against the checkout itself."""
    record = contents.release.get("provenance", {})
    commit = record.get("git_commit")
    copied = {
        name.removeprefix(f"{CODE}/"): contents.folder / name
        for name in contents.sums
        if name.startswith(f"{CODE}/") and (contents.folder / name).is_file()
    }
    copied = {name: path for name, path in copied.items() if name.split("/")[0] in TRACKED}
    committed = None
    if isinstance(commit, str) and not record.get("git_dirty"):
        committed = _committed(checkout, commit)
    if committed is not None:
        return [
            Finding(Kind.BROKEN, f"{CODE}/{name}", f"is not that of commit {commit[:12]}")
            for name in sorted({*copied, *committed})
            if name not in copied or _blob(copied[name]) != committed.get(name)
        ]
    if not (checkout / "Snakefile").is_file() or record.get("code_digest") != current_digest(
        "release"
    ):
        return []
    return [
        Finding(Kind.STALE, f"{CODE}/{name}", "is not the one of this checkout's workflow")
        for name, path in sorted(copied.items())
        if not name.startswith("src/") and not _same_file(path, checkout / name)
    ]


def _same_file(one: Path, other: Path) -> bool:
    return other.is_file() and one.read_bytes() == other.read_bytes()


def _blob(path: Path) -> str:
    """Git's name of a file's content."""
    data = path.read_bytes()
    return hashlib.sha1(b"blob %d\0" % len(data) + data, usedforsecurity=False).hexdigest()


def _committed(checkout: Path, commit: str) -> dict[str, str] | None:
    """File -> git's name of its content, of what a release copies; None if there is no commit."""
    answer = _git(checkout, commit, "ls-tree", "-r", "-z", "--full-tree", commit, "--", *TRACKED)
    if answer is None:
        return None
    entries = (line.split("\t", 1) for line in answer.split("\0") if line)
    found = {name: words.split()[2] for words, name in entries}
    return {name: blob for name, blob in found.items() if _is_copied(name)}


def _is_copied(name: str) -> bool:
    """Whether a release carries a file of the repository."""
    first, *inner = name.split("/")
    hidden = any(part.startswith(".") for part in (first, *inner))
    return not hidden and (first != "src" or inner[:1] == [PACKAGE])


def _claims(lineage: Lineage, commit: str, stages: dict, source: Path) -> Iterator[Finding]:
    for (stage, digest, versions), paths in stages.items():
        if current_digest(stage, source, dict(versions)) != digest:
            clips = {clip for path in paths for clip in lineage.clips(path)}
            what = f"commit {commit[:12]} contains other code of {stage} than the records"
            yield Finding(Kind.BROKEN, stage, what, tuple(sorted(clips)))
        study = study_digest(source / PACKAGE / "simulate" / MEASURED.name)
        other = [
            path for path in paths if quoted_study(lineage.artefacts[path]) not in (None, study)
        ]
        if other:
            clips = {clip for path in other for clip in lineage.clips(path)}
            what = f"commit {commit[:12]} contains another convergence study than is quoted"
            yield Finding(Kind.BROKEN, stage, what, tuple(sorted(clips)))


def _git(checkout: Path, commit: str, *words: str) -> str | None:
    """What git answers; None if it does not know the commit."""
    if not re.fullmatch(r"[0-9a-f]{7,64}", commit):  # never an option or a revision range
        return None
    command = ["git", "-C", str(checkout), *words]
    try:
        answer = subprocess.run(command, capture_output=True, text=True, timeout=60)
    except (OSError, ValueError, subprocess.TimeoutExpired):
        return None
    return answer.stdout if answer.returncode == 0 else None


def _extract(checkout: Path, commit: str, folder: Path) -> bool:
    """Put ``src`` of a commit into `folder`; False if the commit is not known."""
    archive = folder / "src.zip"
    if _git(checkout, commit, "archive", f"--output={archive}", commit, "src") is None:
        return False
    # Unlike tarfile before Python 3.11.4, zipfile never writes outside the folder.
    with zipfile.ZipFile(archive) as packed:
        packed.extractall(folder)
    return True
