"""Imports only point downwards: the floors of the package, and every import held against them."""

import ast
import re
from pathlib import Path

import slipstitch

SOURCE = Path(slipstitch.__file__).parent

# From the ground up. A package imports from floors below its own, never from its own or above, so
# that no two packages import each other.
FLOORS = (
    # what happened, and what is wrong
    {"errors", "progress", "threads", "warp_start"},
    {"project"},
    {"provenance"},
    {"catalogue"},
    # what is known before anything is computed
    {"material", "friction_law"},
    {"bench"},
    {"theory", "page"},
    {"config"},
    # the simulator, and experiments whose outcome is known
    {"cloth"},
    {"protocol"},
    # the stages, in the order in which they run
    {"simulate"},
    {"calibrate", "convergence", "render"},
    {"sample"},
    {"capture", "train"},
    {"instrument"},
    {"evaluate", "measure"},
    {"ablate"},
    # measured data against the friction law
    {"criticise"},
    {"predict"},
    # what is said of the results
    {"doctor"},
    {"status", "release"},
    {"report", "audit"},
    {"publish"},
    # the command line
    {"cli"},
    {"__main__"},
)
FLOOR = {package: number for number, floor in enumerate(FLOORS) for package in floor}


def package_of(module: str) -> str:
    """``slipstitch.render.camera`` -> ``render``."""
    return module.split(".")[1]


def imports_of(file: Path) -> set[str]:
    """Packages of Slipstitch that a source file imports, wherever in it the import stands."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            modules = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{file}:{node.lineno}: a relative import"
            inside = node.module == "slipstitch"
            modules = [f"{node.module}.{a.name}" for a in node.names] if inside else [node.module]
        else:
            continue
        found |= {package_of(name) for name in modules if name.startswith("slipstitch.")}
    return found - {"__version__"}


def imports() -> dict[tuple[str, str], list[str]]:
    """(package, package that it imports) -> files in which it does."""
    found: dict[tuple[str, str], list[str]] = {}
    for file in sorted(SOURCE.rglob("*.py")):
        name = file.relative_to(SOURCE).as_posix()
        package = name.split("/")[0].removesuffix(".py")
        for imported in imports_of(file) - {package}:
            found.setdefault((package, imported), []).append(name)
    return found


def test_every_package_has_a_floor():
    assert sum(map(len, FLOORS)) == len(FLOOR), "a package on two floors"
    there = {path.stem for path in SOURCE.iterdir() if path.suffix == ".py" or path.is_dir()}
    assert not there - set(FLOOR) - {"__init__", "__pycache__"}


def test_imports_point_downwards():
    upwards = {pair: files for pair, files in imports().items() if FLOOR[pair[0]] <= FLOOR[pair[1]]}
    assert not upwards


def test_every_rule_digests_code_that_is_there():
    """A renamed module would leave a rule that no dry run can read."""
    rules = SOURCE.parents[1] / "rules"
    named = {
        name
        for rule in rules.glob("*.smk")
        for name in re.findall(r'code_of\("(.*?)"\)', rule.read_text())
    }
    assert named
    for name in named:
        place = SOURCE / name.replace(".", "/")
        assert place.is_dir() or place.with_suffix(".py").is_file(), name
