"""Only a signature, or a digest from the publisher, tells a release of a forger."""

import shutil
from pathlib import Path

import pytest
from support.forger import Forger
from support.refusal import refused

from slipstitch.cli.main import main
from slipstitch.dataset.audit.auditing import audit_release
from slipstitch.dataset.audit.contents import read_contents
from slipstitch.dataset.audit.findings import NO_FORGER
from slipstitch.dataset.release.checksums import verify


def signers(folder: Path, key: Path) -> Path:
    path = folder / "allowed_signers"
    path.write_text(f"jane@example.org {key.with_suffix('.pub').read_text()}")
    return path


def test_only_a_signature_or_a_digest_from_elsewhere_tells_a_forger(signed, tmp_path, capsys):
    original, key = signed
    forger = Forger(original, tmp_path / "release")
    forger.edit_records(
        "simulate/*", lambda one: one["metadata"]["solver"].update(largest_residual=4.1e-4)
    )
    forger.reseal()
    audit = audit_release(forger.release)
    assert audit.verdict == "intact" and NO_FORGER in audit.notes
    believed = signers(tmp_path, key)
    for told, where in (
        ({"expected": read_contents(original).sums_sha256}, "SHA256SUMS"),
        ({"signers": believed}, "SHA256SUMS.sig"),
    ):
        audit = audit_release(forger.release, **told)
        assert [finding.where for finding in audit.findings] == [where]
        assert NO_FORGER not in audit.notes
        assert len(audit.findings[0].clips) == len(audit.clips)
    assert main(["audit", str(original), "--verify", str(believed)]) == 0
    assert "signed by jane@example.org" in capsys.readouterr().out


def test_a_stranger_s_signature_and_none_are_refused(signed, new_key, tmp_path):
    original = signed[0]
    signer, problem = verify(original, signers(tmp_path, new_key()))
    assert signer is None
    assert "not signed by any of the signers" in problem
    release = Path(shutil.copytree(original, tmp_path / "release"))
    (release / "SHA256SUMS.sig").unlink()
    believed = tmp_path / "signers"
    believed.write_text("jane@example.org ssh-ed25519 AAAA\n")
    assert verify(release, believed) == (None, "the release is not signed")


@pytest.mark.parametrize("option", ["--sign", "--verify"])
def test_without_key_signers_or_tool_is_one_line(signed, capsys, monkeypatch, option):
    results = signed[0].parent / "results"
    command = f"audit {signed[0]} --verify none"
    if option == "--sign":
        made_of = f"--config {results}/config.json --results {results}"
        command = f"release {made_of} --sign none --out-dir mine"
    assert "none: no such file" in refused(capsys, command)
    monkeypatch.setattr("shutil.which", lambda name: None)
    assert "ssh-keygen is not installed" in refused(capsys, command)
