"""SHA256SUMS, in the format of ``sha256sum --check``, and its signature by an SSH key.

The signature says who vouches for every byte of a release. It is made and verified by
``ssh-keygen -Y`` (OpenSSH 8.2 or later), in the format of its SSHSIG protocol.
"""

import hashlib
import os
import re
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path

from slipstitch.base.errors import BadInput, SlipstitchError
from slipstitch.base.provenance import file_digest

#: Keeps a signature of a release from passing as one of anything else.
NAMESPACE = "slipstitch-release"


def _ssh_keygen(*words: str, given: bytes = b"") -> subprocess.CompletedProcess:
    return subprocess.run([_tool(), *words], input=given, capture_output=True, timeout=60)


def _tool() -> str:
    tool = shutil.which("ssh-keygen")
    if tool is None:
        raise BadInput("ssh-keygen is not installed; it signs and verifies (OpenSSH 8.2 or later)")
    return tool


def check_key(key: str | os.PathLike) -> None:
    """Refuse a key that cannot sign, before any work is done."""
    _tool()
    if not Path(key).is_file():
        raise BadInput(f"{key}: no such file; must be an SSH key for signing")


def sign(folder: Path, key: str | os.PathLike) -> None:
    """Write ``SHA256SUMS.sig`` with an SSH key, private or in an agent; else SlipstitchError."""
    words = ["-Y", "sign", "-q", "-n", NAMESPACE, "-f", os.fspath(key), str(folder / SUMS)]
    answer = subprocess.run([_tool(), *words], capture_output=True, text=True)
    if answer.returncode != 0 or not (folder / SIGNATURE).is_file():
        why = answer.stderr.strip().splitlines() or ["no reason given"]
        raise SlipstitchError(f"{key}: cannot sign: {why[-1]}")


def verify(folder: Path, signers: Path) -> tuple[str | None, str | None]:
    """Verify the signature of a release; return who signed it and None, or None and what is wrong.

    `signers` has lines of a name and a public key; BadInput without them, or ``ssh-keygen``.
    """
    _tool()
    if not signers.is_file():
        wanted = "must be a list of allowed signers, one per line: NAME PUBLIC_KEY"
        raise BadInput(f"{signers}: no such file; {wanted}")
    if not (folder / SIGNATURE).is_file():
        return None, "the release is not signed"
    files = "-s", str(folder / SIGNATURE), "-f", str(signers)
    found = _ssh_keygen("-Y", "find-principals", *files)
    if found.returncode != 0 or not found.stdout.strip():
        return None, f"was not signed by any of the signers in {signers}"
    signer = found.stdout.decode(errors="replace").splitlines()[0].strip()
    of_signer = *files, "-n", NAMESPACE, "-I", signer
    if _ssh_keygen("-Y", "verify", *of_signer, given=(folder / SUMS).read_bytes()).returncode != 0:
        return None, f"is not {signer}'s of this {SUMS}"
    return signer, None


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
        found += [Path(place, name).relative_to(folder).as_posix() for name in (*files, *links)]
    return sorted(name for name in found if name not in (SUMS, SIGNATURE, NOT_OURS))


def write_sums(folder: Path) -> str:
    """Write ``SHA256SUMS`` over everything in `folder`; return its own SHA-256."""
    lines = [f"{file_digest(folder / name)}  {name}\n" for name in files_below(folder)]
    text = "".join(lines)
    (folder / SUMS).write_text(text, encoding="utf-8")
    return hashlib.sha256(text.encode()).hexdigest()


def read_sums(folder: Path) -> Mapping[str, str]:
    """Relative path -> digest; BadInput if the file is none, or names one outside the folder."""
    try:
        text = (folder / SUMS).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        raise BadInput(f"{folder}: not a release: no readable {SUMS}") from None
    sums: dict[str, str] = {}
    for number, line in enumerate(text.splitlines(), 1):
        where, match = f"{folder / SUMS} line {number}", _LINE.fullmatch(line)
        if not match:
            raise BadInput(f"{where}: not '<SHA-256>  <file>'")
        digest, name = match.groups()
        if name in sums:
            raise BadInput(f"{where}: {name} is duplicated")
        if Path(name).is_absolute() or ".." in Path(name).parts:
            raise BadInput(f"{where}: {name} is outside the release")
        sums[name] = digest
    if not sums:
        raise BadInput(f"{folder / SUMS}: empty")
    return sums
