"""The complete audit of a release."""

import time
from pathlib import Path

from slipstitch.base.project import PACKAGE
from slipstitch.config import Config
from slipstitch.dataset.audit.admission import limited_memory
from slipstitch.dataset.audit.contents import read_contents
from slipstitch.dataset.audit.files import check_files
from slipstitch.dataset.audit.findings import NO_FORGER, Audit, Finding, Kind, sorted_findings
from slipstitch.dataset.audit.lineage_check import check_lineage
from slipstitch.dataset.audit.staleness import check_commits, check_staleness
from slipstitch.dataset.release.checksums import SIGNATURE, SUMS
from slipstitch.dataset.release.signature import verify


def audit_release(
    folder: Path,
    config: Config | None = None,
    expected: str | None = None,
    jobs: int = 2,
    signers: Path | None = None,
) -> Audit:
    """Audit a release.

    Parameters
    ----------
    folder : path
    config : Config, optional
        Today's configuration, to compare with; the code of today is compared anyway.
    expected : str, optional
        SHA-256 that ``SHA256SUMS`` must have, as the publisher states it elsewhere.
    jobs : int
        Threads.
    signers : path, optional
        Who may have signed it; see `slipstitch.dataset.release.signature.verify`.

    Raises
    ------
    BadInput
        If the folder is no release, or cannot be read without harm.
    """
    with limited_memory():
        return _audit(folder, config, expected, jobs, signers)


def _audit(
    folder: Path, config: Config | None, expected: str | None, jobs: int, signers: Path | None
) -> Audit:
    wall, cpu = time.perf_counter(), time.process_time()
    contents = read_contents(folder)
    every = tuple(contents.clips)
    findings, notes = list(contents.findings), []
    if expected is not None and contents.sums_sha256 != expected.lower():
        what = f"is {contents.sums_sha256}, not the expected {expected.lower()}: another release"
        findings.append(Finding(Kind.ALTERED, SUMS, what, every))
    if signers is not None:
        signer, problem = verify(folder, signers)
        if problem is not None:
            findings.append(Finding(Kind.ALTERED, SIGNATURE, problem, every))
        else:
            notes.append(f"signed by {signer}")
    elif expected is None:
        notes.append(NO_FORGER)
    of_files, others, numbers, shards = check_files(contents, jobs)
    notes += others
    parts = [check_lineage(contents, shards), check_commits(contents, PACKAGE.parents[1])]
    findings += [*of_files, *check_staleness(contents, config)]
    for found, noted in parts:
        findings += found
        notes += noted
    cost = {
        "clips": len(contents.clips),
        "wall_s": round(time.perf_counter() - wall, 2),
        "cpu_s": round(time.process_time() - cpu, 2),
    }
    return Audit(
        release=contents.name,
        sums_sha256=contents.sums_sha256,
        numbers=numbers | cost,
        findings=sorted_findings(findings),
        notes=notes,
        clips=contents.clips,
    )
