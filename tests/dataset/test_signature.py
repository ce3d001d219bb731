"""Only a signature, or a digest from the publisher, tells a release of a forger."""

import shutil
import subprocess
from pathlib import Path

import pytest
from support import synthetic_chain
from support.forger import Forger

from slipstitch.cli.main import main
from slipstitch.dataset.audit.auditing import audit_release
from slipstitch.dataset.audit.contents import read_contents
from slipstitch.dataset.audit.findings import NO_FORGER
from slipstitch.dataset.release.assembly import write_release
from slipstitch.dataset.release.checksums import verify

ROOT = Path(__file__).parents[2]
CONFIG = synthetic_chain.config(
    grid={
        "materials": ["gray-interlock", "ivory-rib-knit"],
        "frictions": [0.1, 0.3],
        "replicates": 2,
    },
    render={
        "pixels": 16,
        "viewpoints": ["calibrated"],
        "textures": ["stripes", "tartan"],
        "floors": ["matte", "ceramic"],
    },
)


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    folder = tmp_path_factory.mktemp("signature")
    results = synthetic_chain.write(CONFIG, folder)
    write_release(CONFIG, results, folder / "release", ROOT, new_key(folder))
    return folder / "release"


def new_key(folder: Path) -> Path:
    key = folder / "key"
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(key)], check=True)
    return key


def signers(folder: Path, key: Path) -> Path:
    path = folder / "allowed_signers"
    path.write_text(f"jane@example.org {key.with_suffix('.pub').read_text()}")
    return path


def test_only_a_signature_or_a_digest_from_elsewhere_tells_a_forger(original, tmp_path):
    forger = Forger(original, tmp_path / "release")
    forger.edit_records(
        "simulate/*", lambda one: one["metadata"]["solver"].update(largest_residual=4.1e-4)
    )
    forger.reseal()
    audit = audit_release(forger.release)
    assert audit.verdict == "intact" and NO_FORGER in audit.notes
    published = read_contents(original).sums_sha256
    audit = audit_release(forger.release, expected=published)
    assert [finding.where for finding in audit.findings] == ["SHA256SUMS"]
    assert NO_FORGER not in audit.notes
    believed = signers(tmp_path, original.parent / "key")
    audit = audit_release(forger.release, signers=believed)
    assert [finding.where for finding in audit.findings] == ["SHA256SUMS.sig"]
    assert len(audit.findings[0].clips) == len(audit.clips)


def test_signature_says_who_vouches(original, tmp_path, capsys):
    believed = signers(tmp_path, original.parent / "key")
    assert main(["audit", str(original), "--verify", str(believed)]) == 0
    assert "signed by jane@example.org" in capsys.readouterr().out


def test_a_stranger_s_signature_and_none_are_refused(original, tmp_path):
    signer, problem = verify(original, signers(tmp_path, new_key(tmp_path)))
    assert signer is None
    assert "not signed by any of the signers" in problem
    release = Path(shutil.copytree(original, tmp_path / "release"))
    (release / "SHA256SUMS.sig").unlink()
    believed = tmp_path / "signers"
    believed.write_text("jane@example.org ssh-ed25519 AAAA\n")
    assert verify(release, believed) == (None, "the release is not signed")


@pytest.mark.parametrize("words", [["--sign", "none"], ["--verify", "none"]])
def test_without_key_signers_or_tool_is_one_line(original, capsys, monkeypatch, words):
    config = ["--config", str(original.parent / "results/config.json")]
    out = ["--results", str(original.parent / "results"), "--out-dir", "mine"]
    command = ["release", *config, *out] if words[0] == "--sign" else ["audit", str(original)]
    assert main([*command, *words]) == 2
    assert "none: no such file" in capsys.readouterr().err
    monkeypatch.setattr("shutil.which", lambda name: None)
    assert main([*command, *words]) == 2
    said = capsys.readouterr().err
    assert "ssh-keygen is not installed" in said
    assert said.count("\n") == 1
