"""Which tests are slow, who runs them, and seeds of the hidden effects.

The seeds are fixed, so that a red run can be repeated, or fresh on demand.
"""

import secrets
import zlib
from collections import Counter

import numpy as np
import pytest
from xdist.scheduler.loadscope import LoadScopeScheduling

from slipstitch.base.provenance import record

# Tests in folders of their own, or of one chain that takes minutes, share a process.
ALONE = ("dry_run", "chosen_settings", "wheel")
# These begin first, in this order: else one process works on for minutes after the other's end.
LONGEST = (
    "chain",
    "tests/criticise/test_cloth_campaigns.py",
    "tests/physics/test_self_contact.py",
    "tests/criticise/test_departures.py",
)


class SharedFixtures(LoadScopeScheduling):
    """Give a file to one process of pytest-xdist, and all files that use the chain to one."""

    def _split_scope(self, nodeid: str) -> str:
        file = nodeid.partition("::")[0]
        if "tests/workflow/" in file and not file.endswith(tuple(f"{name}.py" for name in ALONE)):
            return "chain"
        return file

    def _assign_work_unit(self, node) -> None:
        for scope in reversed(LONGEST):
            if scope in self.workqueue:
                self.workqueue.move_to_end(scope, last=False)
        super()._assign_work_unit(node)


def pytest_xdist_make_scheduler(config, log):
    return SharedFixtures(config, log)


def pytest_addoption(parser):
    parser.addoption("--fresh-seeds", action="store_true", help="draw the hidden effects anew")
    parser.addoption(
        "--seeds-from", type=int, metavar="NUMBER", help="those that a run with --fresh-seeds drew"
    )


def pytest_configure(config):
    # Before xdist's processes start: they all get one number.
    if config.option.fresh_seeds and config.option.seeds_from is None:
        config.option.seeds_from = secrets.randbelow(10**9)


@pytest.hookimpl(tryfirst=True)  # before -m chooses
def pytest_collection_modifyitems(items):
    """Mark as slow all but the first cases of a test that states their number."""
    counted = Counter()
    for item in items:
        for mark in item.iter_markers("default_cases"):
            function = item.nodeid.partition("[")[0]
            counted[function] += 1
            if counted[function] > mark.args[0]:
                item.add_marker("slow")


def pytest_terminal_summary(terminalreporter, config):
    if config.option.seeds_from is not None:
        number = config.option.seeds_from
        terminalreporter.write_line(f"hidden effects: --seeds-from {number} repeats them")


@pytest.fixture(autouse=True)
def no_earlier_attempts(monkeypatch):
    """Every test is a process of its own: what a resumed training took stays in its test."""
    monkeypatch.setattr(record, "_EARLIER_S", [0.0, 0.0])


@pytest.fixture
def hidden_seed(request):
    """A function of the fixed seed: it, or a fresh one below ``limit``."""

    def seed(fixed: int, limit: int = 10**6) -> int:
        number = request.config.option.seeds_from
        if number is None:
            return fixed
        test = zlib.crc32(request.node.nodeid.encode())
        return int(np.random.default_rng([number, test]).integers(limit))

    return seed
