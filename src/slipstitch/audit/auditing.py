"""The whole audit of one release."""

import time
from pathlib import Path

from slipstitch.audit.contents import read_contents
from slipstitch.audit.derived import check_derived
from slipstitch.audit.files import check_files
from slipstitch.audit.findings import Audit, Finding, Kind, sorted_findings
from slipstitch.audit.lineage_check import check_lineage
from slipstitch.audit.staleness import check_commits, check_staleness
from slipstitch.config import Config
from slipstitch.provenance import start_clock
from slipstitch.release.checksums import SUMS


def audit_release(
    folder: Path, config: Config | None = None, expected: str | None = None, jobs: int = 2
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

    Raises
    ------
    BadInput
        If the folder is no release.
    """
    wall, _ = start_clock()
    cpu = time.process_time()
    contents = read_contents(folder)
    findings = list(contents.findings)
    if expected is not None and contents.sums_sha256 != expected.lower():
        what = f"is {contents.sums_sha256}, not the expected {expected.lower()}: another release"
        findings.append(Finding(Kind.ALTERED, SUMS, what, tuple(contents.clips)))
    of_files, numbers, shards = check_files(contents, jobs)
    of_lineage, notes = check_lineage(contents, shards)
    of_itself, unmade = check_derived(contents)
    of_commits, more = check_commits(contents, Path(__file__).resolve().parents[3])
    findings += [*of_files, *of_lineage, *of_itself, *of_commits]
    findings += check_staleness(contents, config)
    cost = {
        "clips": len(contents.clips),
        "wall_s": round(time.perf_counter() - wall, 2),
        "cpu_s": round(time.process_time() - cpu, 2),
    }
    if expected is None:
        notes.append("no digest of SHA256SUMS from elsewhere was given (--expect)")
    return Audit(
        release=contents.name,
        sums_sha256=contents.sums_sha256,
        numbers=numbers | cost,
        findings=sorted_findings(findings),
        notes=[*notes, *unmade, *more],
        clips=contents.clips,
    )
