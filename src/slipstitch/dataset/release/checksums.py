"""SHA256SUMS: digests of all files of a folder, in the format of ``sha256sum --check``."""

import hashlib
import os
import re
from collections.abc import Mapping
from pathlib import Path

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import file_digest

SUMS = "SHA256SUMS"
SIGNATURE = "SHA256SUMS.sig"
# Snakemake leaves this empty file in a folder that a rule makes.
NOT_OURS = ".snakemake_timestamp"
_LINE = re.compile(r"([0-9a-f]{64})  (.+)")


def files_below(folder: Path) -> list[str]:
    """Relative paths of all files of a release but its sums and their signature, sorted."""
    found = []
    for place, names, files in os.walk(folder):
        links = [name for name in names if os.path.islink(os.path.join(place, name))]
        for name in (*files, *links):
            found.append(Path(place, name).relative_to(folder).as_posix())
    return sorted(name for name in found if name not in (SUMS, SIGNATURE, NOT_OURS))


def write_sums(folder: Path) -> str:
    """Write ``SHA256SUMS`` over everything in `folder`; return its own SHA-256."""
    lines = [f"{file_digest(folder / name)}  {name}\n" for name in files_below(folder)]
    text = "".join(lines)
    (folder / SUMS).write_text(text, encoding="utf-8")
    return hashlib.sha256(text.encode()).hexdigest()


def read_sums(folder: Path) -> Mapping[str, str]:
    """Relative path -> digest.

    Raises
    ------
    BadInput
        If the file is missing, not of this format, or names a file outside the folder.
    """
    try:
        text = (folder / SUMS).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        raise BadInput(f"{folder}: not a release: no readable {SUMS}") from None
    sums: dict[str, str] = {}
    for number, line in enumerate(text.splitlines(), 1):
        match = _LINE.fullmatch(line)
        if not match:
            raise BadInput(f"{folder / SUMS} line {number}: not '<SHA-256>  <file>'")
        digest, name = match.groups()
        if name in sums:
            raise BadInput(f"{folder / SUMS} line {number}: {name} is duplicated")
        if Path(name).is_absolute() or ".." in Path(name).parts:
            raise BadInput(f"{folder / SUMS} line {number}: {name} is outside the release")
        sums[name] = digest
    if not sums:
        raise BadInput(f"{folder / SUMS}: empty")
    return sums
