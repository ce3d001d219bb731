"""The findings of an audit as text for a terminal and as an HTML page."""

from pathlib import Path

from slipstitch.base.page.templates import render
from slipstitch.base.page.wording import size
from slipstitch.base.provenance import write_text
from slipstitch.dataset.audit.findings import MEANING, Audit, Kind, in_words

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
