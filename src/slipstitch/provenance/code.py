"""Digest of the sources that a stage's result depends on, found without running them.

A stage is rerun when its digest changes. The digest covers the modules of the stage's package and
every module of Slipstitch that these import, directly or through others, wherever in the file the
import stands; it follows modules, not whole packages, so that editing what a stage never imports
leaves the stage alone. Files that are no Python source (tables, templates) count in every package
of which a module was met. Imports by computed name are not seen; the project has none in stages.
"""

import ast
import functools
import hashlib
import os
from pathlib import Path

PACKAGE = "slipstitch"

# These decide which values reach a stage or write down what happened; the values themselves are
# compared as parameters of the rules, so editing them shall not throw away simulations.
NOT_PART_OF_A_RESULT = (
    "slipstitch.cli",
    "slipstitch.__main__",
    "slipstitch.config",
    "slipstitch.doctor",
    "slipstitch.errors",
    "slipstitch.progress",
    "slipstitch.provenance",
)
IGNORED_SUFFIXES = (".pyc", ".pyo", ".tmp", ".swp", "~")


def _module_file(name: str, root: Path) -> Path | None:
    """Source of the module `name`, None if `root` has none (a name inside a module, say)."""
    base = root.joinpath(*name.split("."))
    for candidate in (base / "__init__.py", base.with_suffix(".py")):
        if candidate.is_file():
            return candidate
    return None


def _imported(name: str, source: Path) -> set[str]:
    """Dotted names that the module imports inside the package; some may be no modules."""
    text = source.read_text(encoding="utf-8")
    return _imports_in(name, source.name == "__init__.py", text)


@functools.cache
def _imports_in(name: str, is_package: bool, text: str) -> set[str]:
    """`_imported` by the source's text: an audit reads the same sources in several places."""
    parts = name.split(".")
    names: set[str] = set()
    for node in ast.walk(ast.parse(text, filename=name)):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            if node.level:
                depth = len(parts) - node.level + is_package
                base = ".".join(parts[:depth] + ([node.module] if node.module else []))
            else:
                base = node.module or ""
            names.add(base)
            names.update(f"{base}.{alias.name}" for alias in node.names)
    return {found for found in names if found.split(".")[0] == PACKAGE}


def _with_parents(name: str) -> list[str]:
    """Importing a.b.c runs a, a.b and a.b.c."""
    parts = name.split(".")
    return [".".join(parts[: length + 1]) for length in range(len(parts))]


def _counts(name: str) -> bool:
    # The package itself holds nothing but its version: a release shall not rerun everything.
    return name != PACKAGE and not any(
        name == left or name.startswith(left + ".") for left in NOT_PART_OF_A_RESULT
    )


def code_sources(stage: str, root: str | os.PathLike | None = None) -> list[Path]:
    """Files that the result of `stage` depends on, sorted by their path below `root`.

    Parameters
    ----------
    stage : str
        Package below ``slipstitch``, such as ``"render"``; or a module, such as
        ``"render.preview"``, of which only the import closure counts then.
    root : path, optional
        Folder that holds the package ``slipstitch``; the running one's by default.

    Raises
    ------
    ModuleNotFoundError
        If there is no such package.
    """
    base = Path(root) if root is not None else Path(__file__).resolve().parents[2]
    start = f"{PACKAGE}.{stage}"
    entry = _module_file(start, base)
    if entry is None:
        raise ModuleNotFoundError(f"there is no package {start} in {base}")
    waiting = [start]
    if entry.name == "__init__.py":
        for source in entry.parent.rglob("*.py"):
            relative = source.relative_to(base).with_suffix("")
            waiting.append(".".join(relative.parts).removesuffix(".__init__"))
    modules: dict[str, Path] = {}
    seen: set[str] = set()
    while waiting:
        for name in _with_parents(waiting.pop()):
            if name in seen:
                continue
            seen.add(name)
            own = name == start or name.startswith(start + ".")
            source = _module_file(name, base) if own or _counts(name) else None
            if source is None:
                continue
            modules[name] = source
            waiting.extend(_imported(name, source))
    files = set(modules.values())
    for folder in {source.parent for source in modules.values()} - {base / PACKAGE}:
        files.update(_data_files(folder))
    return sorted(files, key=lambda file: file.relative_to(base).as_posix())


def _data_files(package: Path) -> set[Path]:
    """Files that are no sources in a package and in those folders of it that are no packages."""
    found = set()
    for entry in package.iterdir():
        if entry.is_dir():
            if entry.name != "__pycache__" and not (entry / "__init__.py").exists():
                found |= _data_files(entry)
        elif not entry.name.endswith((".py", *IGNORED_SUFFIXES)) and entry.name[0] != ".":
            found.add(entry)
    return found


@functools.cache
def code_digest(stage: str, root: str | os.PathLike | None = None) -> str:
    """SHA-256 over the sources that the result of `stage` depends on (64 hexadecimal digits).

    Deterministic: a function of the files' paths below the package and their contents only. The
    answer is kept for the life of the process. Parameters and errors as for `code_sources`.
    """
    base = Path(root) if root is not None else Path(__file__).resolve().parents[2]
    digest = hashlib.sha256()
    for file in code_sources(stage, base):
        content = file.read_bytes()
        digest.update(f"{file.relative_to(base).as_posix()}\0{len(content)}\0".encode())
        digest.update(content)
    return digest.hexdigest()
