"""The findings of an audit, its verdict, and both as text, JSON and an HTML page."""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

from slipstitch.base.page.templates import render
from slipstitch.base.page.wording import size
from slipstitch.base.provenance import write_text


class Kind(StrEnum):
    """Sorts of findings, the worst first."""

    ALTERED = "altered"
    MISSING = "missing"
    UNEXPLAINED = "unexplained"
    BROKEN = "broken chain"
    STALE = "stale"


MEANING = {
    Kind.ALTERED: "a file or its images do not match the release",
    Kind.MISSING: "a file of the release is missing",
    Kind.UNEXPLAINED: "a shard that is not part of the release, but would be loaded with it",
    Kind.BROKEN: "a clip cannot be traced to its origin, or its record is inconsistent",
    Kind.STALE: "the current code or configuration would give different results",
}


@dataclass(frozen=True)
class Finding:
    """One thing that is not as it should be."""

    kind: Kind
    where: str  # a file of the release, an artefact as the records call it, or a stage
    what: str
    clips: tuple[str, ...] = ()  # videos that it touches


@dataclass
class Audit:
    """The outcome of an audit."""

    release: str  # name and version, as the release calls itself
    sums_sha256: str  # SHA-256 of its ``SHA256SUMS``
    # Files, bytes, clips and images that were looked at; ``wall_s, cpu_s``
    numbers: dict[str, Any] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)  # what could not be compared, and why
    clips: list[str] = field(default_factory=list)  # all videos of the release

    @property
    def verdict(self) -> str:
        """``intact``, ``stale`` (intact, but older than the code or configuration), ``damaged``."""
        kinds = {finding.kind for finding in self.findings}
        if not kinds:
            return "intact"
        return "stale" if kinds == {Kind.STALE} else "damaged"

    def of_kind(self, kind: Kind) -> list[Finding]:
        """Findings of one sort."""
        return [one for one in self.findings if one.kind is kind]

    def clip_kinds(self) -> dict[str, list[str]]:
        """Clip -> sorts of what was found of it; empty for an intact one."""
        kinds: dict[str, set[str]] = {clip: set() for clip in self.clips}
        for finding in self.findings:
            for clip in finding.clips:
                kinds.setdefault(clip, set()).add(finding.kind.value)
        return {clip: sorted(found) for clip, found in kinds.items()}

    def damaged_clips(self) -> dict[str, list[str]]:
        """`clip_kinds` of the clips of which more is wrong than that they are stale."""
        kinds = self.clip_kinds()
        return {clip: found for clip, found in kinds.items() if set(found) - {Kind.STALE.value}}

    def as_json(self) -> dict[str, Any]:
        """The outcome as JSON can hold it."""
        return {
            "release": self.release,
            "verdict": self.verdict,
            "sums_sha256": self.sums_sha256,
            "numbers": self.numbers,
            "counts": {kind.value: len(self.of_kind(kind)) for kind in Kind},
            "findings": [asdict(finding) for finding in self.findings],
            "notes": self.notes,
            "clips": self.clip_kinds(),
        }


def sorted_findings(findings: Iterable[Finding]) -> list[Finding]:
    """Without repetitions, the worst kind first, then by place."""
    order = list(Kind)
    unique = dict.fromkeys(findings)
    return sorted(unique, key=lambda finding: (order.index(finding.kind), finding.where))


def in_words(clips: Sequence[str], all_clips: int) -> str:
    """A short list of the clips."""
    if clips and len(clips) == all_clips:
        return f"all {all_clips} clips"
    return _first_three(clips)


def _first_three(names: Sequence[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


#: What an audit can promise to whoever checks neither signature nor published digest.
NO_FORGER = (
    "an audit finds accidents and careless changes. Whoever has no signature to check (--verify) "
    "and no digest from the publisher (--expect) is not protected against a deliberate forger, "
    "who makes all files and records agree"
)


def not_part(of: str, names: Sequence[str]) -> str:
    """A note on files that hubs, desktops and others have added."""
    shown = (name.partition("/")[0] if name.startswith(".") else name for name in names)
    return f"not part of {of}, not looked at: {_first_three(list(dict.fromkeys(shown)))}"


_TEMPLATE = Path(__file__).with_name("audit.html.j2")

_MOST_LINES = 12
VERDICTS = {
    "intact": "intact: every file, image, label and record matches the release",
    "stale": "intact, but stale: the current code or configuration would give different results",
    "damaged": "DAMAGED: the affected clips are listed below",
}


def as_text(audit: Audit) -> str:
    """The outcome as lines."""
    numbers = audit.numbers
    lines = [
        f"{audit.release}: {VERDICTS[audit.verdict]}",
        f"{numbers['files']} files, {size(numbers['bytes'])}, {numbers['images']} images of "
        f"{numbers['clips']} clips checked in {numbers['wall_s']:.1f} s; "
        f"{len(audit.damaged_clips())} clips damaged",
        f"SHA-256 of SHA256SUMS: {audit.sums_sha256}",
    ]
    for kind in Kind:
        found = audit.of_kind(kind)
        if found:
            lines += ["", f"{kind.value} ({len(found)}): {MEANING[kind]}"]
        for finding in found[:_MOST_LINES]:
            clips = in_words(finding.clips, len(audit.clips))
            lines.append(f"  {finding.where}: {finding.what}" + (f" [{clips}]" if clips else ""))
        if len(found) > _MOST_LINES:
            lines.append(f"  ... and {len(found) - _MOST_LINES} more (all are in --json or --page)")
    if audit.notes:
        lines += ["", *(f"note: {note}" for note in audit.notes)]
    return "\n".join(map(printable, lines))


def printable(line: str) -> str:
    """A line without what would move a terminal's cursor: names in a release are anybody's."""
    return "".join(sign if sign.isprintable() else "\N{REPLACEMENT CHARACTER}" for sign in line)


def write_page(audit: Audit, path: Path) -> None:
    """Write the outcome as one self-contained HTML page."""
    text = render(
        _TEMPLATE,
        audit=audit,
        verdict=VERDICTS[audit.verdict],
        groups=[(kind.value, MEANING[kind], audit.of_kind(kind)) for kind in Kind],
        damaged=audit.damaged_clips(),
        in_words=lambda clips: in_words(clips, len(audit.clips)),
    )
    write_text(path, text)
