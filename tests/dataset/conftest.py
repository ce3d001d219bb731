"""Two releases of made-up chains, made once: a test that alters one has a copy."""

import subprocess
from pathlib import Path

import pytest
from support import synthetic_chain
from support.forger import Forger

from slipstitch.dataset.release.assembly import write_release

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def results(tmp_path_factory):
    """Results of the default configuration: 144 videos."""
    return synthetic_chain.write(synthetic_chain.config(), tmp_path_factory.mktemp("chain"))


@pytest.fixture(scope="session")
def original(results):
    """Their release."""
    write_release(synthetic_chain.config(), results, results.parent / "release", ROOT)
    return results.parent / "release"


@pytest.fixture
def forger(original, tmp_path):
    """A copy of that release to be damaged."""
    return Forger(original, tmp_path / "release")


@pytest.fixture(scope="session")
def new_key(tmp_path_factory):
    """A function that makes an SSH key and returns its file."""

    def made() -> Path:
        key = tmp_path_factory.mktemp("key") / "key"
        subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(key)], check=True)
        return key

    return made


@pytest.fixture(scope="session")
def signed(tmp_path_factory, new_key):
    """A release of 8 videos, its results beside it, and the key that signed it."""
    config = synthetic_chain.config(
        grid={"materials": ["gray-interlock"], "frictions": [0.1, 0.3], "replicates": 2},
        render={"pixels": 16, "viewpoints": ["calibrated"], "textures": ["stripes", "tartan"]},
    )
    results, key = synthetic_chain.write(config, tmp_path_factory.mktemp("signed")), new_key()
    write_release(config, results, results.parent / "release", ROOT, key)
    return results.parent / "release", key
