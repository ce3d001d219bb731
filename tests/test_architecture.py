"""Eleven wings; an import only points down the list."""

import ast
import re
from pathlib import Path

import slipstitch
from slipstitch.base.provenance.code import STAGES, code_digest

SOURCE = Path(slipstitch.__file__).parent
ROOT = SOURCE.parents[1]

# From the top down. A wing imports from itself and from wings below.
WINGS = (
    "cli",
    "report",
    "criticise",
    "film",
    "learning",
    "dataset",
    "images",
    "physics",
    "design",
    "config",
    "base",
)
# Pairs of wings that do not import each other although one stands above the other.
APART = {("criticise", "film"), ("criticise", "learning"), ("criticise", "dataset")}


def imported_wings(file: Path) -> set[str]:
    """Wings that a source file imports, wherever in it the import stands."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            modules = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{file}:{node.lineno}: a relative import"
            modules = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            continue
        found |= {name.split(".")[1] for name in modules if name.startswith("slipstitch.")}
    return found - {"__version__"}


def test_the_house_has_eleven_wings():
    there = {path.name for path in SOURCE.iterdir() if (path / "__init__.py").exists()}
    assert there == set(WINGS)


def test_imports_point_down():
    wrong = set()
    for file in sorted(SOURCE.rglob("*.py")):
        wing = file.relative_to(SOURCE).parts[0]
        if wing in WINGS:
            for other in imported_wings(file) - {wing}:
                if WINGS.index(other) < WINGS.index(wing) or (wing, other) in APART:
                    wrong.add(f"{file.relative_to(SOURCE)} imports {other}")
    assert not wrong


def test_every_rule_digests_a_stage_that_is_there():
    named = {
        name
        for rule in (ROOT / "rules").glob("*.smk")
        for name in re.findall(r'code_of\("(.*?)"\)', rule.read_text())
    }
    assert named <= set(STAGES)
    for stage in STAGES:
        assert code_digest(stage), stage
