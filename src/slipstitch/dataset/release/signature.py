"""A signature of SHA256SUMS by an SSH key: who vouches for every byte of a release.

Made and verified by ``ssh-keygen -Y`` (OpenSSH 8.2 or later), in the format of its SSHSIG protocol.
"""

import os
import shutil
import subprocess
from pathlib import Path

from slipstitch.base.errors import BadInput, SlipstitchError
from slipstitch.dataset.release.checksums import SIGNATURE, SUMS

#: Keeps a signature of a release from passing as one of anything else.
NAMESPACE = "slipstitch-release"


def _tool() -> str:
    tool = shutil.which("ssh-keygen")
    if tool is None:
        raise BadInput("ssh-keygen is not installed; it signs and verifies (OpenSSH 8.2 or later)")
    return tool


def check_key(key: str | os.PathLike) -> None:
    """Refuse a key that cannot sign, before any work is done.

    Raises
    ------
    BadInput
    """
    _tool()
    if not Path(key).is_file():
        raise BadInput(f"{key}: no such file; must be an SSH key for signing")


def sign(folder: Path, key: str | os.PathLike) -> None:
    """Write ``SHA256SUMS.sig`` beside the sums of a release.

    Parameters
    ----------
    folder : path
    key : path
        A private SSH key, or a public one whose private half an agent holds.

    Raises
    ------
    SlipstitchError
        If it cannot sign.
    """
    words = ["-Y", "sign", "-q", "-n", NAMESPACE, "-f", os.fspath(key), str(folder / SUMS)]
    answer = subprocess.run([_tool(), *words], capture_output=True, text=True)
    if answer.returncode != 0 or not (folder / SIGNATURE).is_file():
        raise SlipstitchError(f"{key}: cannot sign: {_last_line(answer.stderr)}")


def verify(folder: Path, signers: Path) -> tuple[str | None, str | None]:
    """Verify the signature of a release.

    Parameters
    ----------
    folder : path
    signers : path
        Who may sign, as ``ssh-keygen`` wants it: lines of a name and a public key.

    Returns
    -------
    signer : str or None
        Who signed it.
    problem : str or None
        What is wrong instead.

    Raises
    ------
    BadInput
        If there is no such file of signers, or no ``ssh-keygen``.
    """
    tool = _tool()
    if not signers.is_file():
        raise BadInput(
            f"{signers}: no such file; must be a list of allowed signers, one per "
            "line: NAME PUBLIC_KEY"
        )
    if not (folder / SIGNATURE).is_file():
        return None, "the release is not signed"
    files = ["-s", str(folder / SIGNATURE), "-f", str(signers)]
    sums = (folder / SUMS).read_bytes()
    found = _run(tool, ["-Y", "find-principals", *files])
    if found.returncode != 0 or not found.stdout.strip():
        return None, f"was not signed by any of the signers in {signers}"
    signer = found.stdout.decode(errors="replace").splitlines()[0].strip()
    words = ["-Y", "verify", *files, "-n", NAMESPACE, "-I", signer]
    if _run(tool, words, sums).returncode != 0:
        return None, f"is not {signer}'s of this {SUMS}"
    return signer, None


def _run(tool: str, words: list[str], given: bytes = b"") -> subprocess.CompletedProcess:
    return subprocess.run([tool, *words], input=given, capture_output=True, timeout=60)


def _last_line(text: str) -> str:
    return (text.strip().splitlines() or ["no reason given"])[-1]
