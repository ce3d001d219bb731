"""Digest of the sources that a stage's result depends on, found without running them.

A stage is rerun when its digest changes. The digest covers the modules of the stage's package and
every module of Slipstitch that these import, directly or through others, wherever in the file the
import stands; it follows modules, not whole packages, so that editing what a stage never imports
leaves the stage alone. Imports by computed name are not seen; the project has none in stages.

What computes counts, what only words does not: of a module counts its normal form, without
comments, layout, docstrings, descriptions and the words of errors
(`slipstitch.provenance.normal_form`). Four kinds of source count in part:

- The command line, reading and checking a configuration, records and progress do not count: they
  decide which values reach a stage or write down what happened, and the values themselves are
  compared as parameters of the rules.
- The configuration's types count where they compute: a function, a constant, a property or a
  method counts in a stage that imports it or speaks of an attribute of its name, directly or
  through another such piece; with it count the modules from which it takes what it computes with.
  Fields do not, nor their defaults, bounds and validators: a value is compared, whatever made it.
  So a stage must be handed its settings, never make them of defaults.
- A catalogue's entries (fabrics, viewpoints, textures, floors) do not count: a rule has those that
  it uses as its parameter, so that one more changes no other. Its functions and classes do.
- A file that is no Python source (a table, a template) counts where a module or a template that
  counts names it, and in all of its package if none at all does; but for `QUOTED` ones.

Of the libraries that a stage's modules import, the versions of those count whose releases change
numbers or pixels (`RESULT_PACKAGES`), without the local tag that names a build.
"""

import ast
import functools
import hashlib
import importlib.metadata
from collections.abc import Iterable, Mapping
from pathlib import Path

from slipstitch.provenance.normal_form import (
    computing_definitions,
    names_in,
    normal_form,
    parsed,
    without_entries,
    written,
)

PACKAGE = "slipstitch"

NOT_PART_OF_A_RESULT = (
    "slipstitch.cli",
    "slipstitch.__main__",
    "slipstitch.config.load",
    "slipstitch.config.schema",
    "slipstitch.doctor",
    "slipstitch.errors",
    "slipstitch.progress",
    "slipstitch.warp_start",
    "slipstitch.provenance",
)
CATALOGUES = ("slipstitch.catalogue", "slipstitch.material.fabrics")
CONFIGURATION = "slipstitch.config"
# Module -> the package whose version changes what a stage that imports it gives.
RESULT_PACKAGES = {"bpy": "bpy", "torch": "torch", "warp": "warp-lang"}
# Tables that results only quote, each with the SHA-256 of what it quotes: a new one computes
# nothing anew. A rule whose pages show one has its digest as a parameter.
QUOTED = ("slipstitch/simulate/convergence.json",)
IGNORED_SUFFIXES = (".pyc", ".pyo", ".tmp", ".swp", "~")


def _module_file(name: str, root: Path) -> Path | None:
    """Source of the module `name`, None if `root` has none (a name inside a module, say)."""
    base = root.joinpath(*name.split("."))
    for candidate in (base / "__init__.py", base.with_suffix(".py")):
        if candidate.is_file():
            return candidate
    return None


def _module_name(source: Path, root: Path) -> str:
    parts = source.relative_to(root).with_suffix("").parts
    return ".".join(parts).removesuffix(".__init__")


def _text(source: Path) -> str:
    return source.read_text(encoding="utf-8")


def _imported(name: str, source: Path) -> frozenset[str]:
    """Dotted names that the module imports inside the package; some may be no modules."""
    modules, members, _ = _imports_in(name, source.name == "__init__.py", _text(source))
    return modules | members


@functools.cache
def _imports_in(
    name: str, is_package: bool, text: str
) -> tuple[frozenset[str], frozenset[str], frozenset[str]]:
    """Modules that are imported or imported from, and what is imported from them, which may be
    modules too; and the packages whose versions count. By the source's text, as an audit reads the
    same sources in several places.
    """
    found = _import_statements(name, is_package, text)
    modules = {module for module, _, _ in found}
    members = {f"{module}.{member}" for module, member, _ in found if member}
    foreign = {RESULT_PACKAGES.get(module.partition(".")[0]) for module in modules} - {None}
    return _of_the_package(modules), _of_the_package(members), frozenset(map(str, foreign))


@functools.cache
def _import_statements(name: str, is_package: bool, text: str) -> list[tuple[str, str, str]]:
    """Module, what is imported from it (empty: itself), and the bare name that this is then."""
    parts = name.split(".")
    found: list[tuple[str, str, str]] = []
    for node in ast.walk(parsed(text, name)):
        if isinstance(node, ast.Import):
            found += [
                (alias.name, "", alias.asname or alias.name.partition(".")[0])
                for alias in node.names
            ]
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                depth = len(parts) - node.level + is_package
                base = ".".join(parts[:depth] + ([node.module] if node.module else []))
            found += [(base, alias.name, alias.asname or alias.name) for alias in node.names]
    return found


def _of_the_package(names: set[str]) -> frozenset[str]:
    return frozenset(name for name in names if _is_in(name, [PACKAGE]))


def _with_parents(name: str) -> list[str]:
    """Importing a.b.c runs a, a.b and a.b.c."""
    parts = name.split(".")
    return [".".join(parts[: length + 1]) for length in range(len(parts))]


def _is_in(name: str, packages: Iterable[str]) -> bool:
    return any(name == package or name.startswith(package + ".") for package in packages)


def _counts(name: str) -> bool:
    # The package itself holds nothing but its version: a release shall not rerun everything.
    return name != PACKAGE and not _is_in(name, NOT_PART_OF_A_RESULT) and not _is_settings(name)


def _is_settings(name: str) -> bool:
    """Whether a module is one of the configuration's types."""
    if _is_in(name, NOT_PART_OF_A_RESULT):
        return False
    return _is_in(name, [CONFIGURATION])


def _modules(stage: str, base: Path) -> tuple[dict[str, Path], dict[str, list[str]]]:
    """Modules that count as a whole, by name; and what of the configuration counts for them."""
    start = f"{PACKAGE}.{stage}"
    entry = _module_file(start, base)
    if entry is None:
        raise ModuleNotFoundError(f"no package {start} in {base}")
    whole = _is_in(start, [CONFIGURATION])
    waiting = [start]
    if entry.name == "__init__.py":
        waiting += [_module_name(source, base) for source in entry.parent.rglob("*.py")]
    modules: dict[str, Path] = {}
    seen: set[str] = set()
    while waiting:
        for name in _with_parents(waiting.pop()):
            if name in seen:
                continue
            seen.add(name)
            own = _is_in(name, [start]) and (whole or not _is_settings(name))
            source = _module_file(name, base) if own or _counts(name) else None
            if source is None:
                continue
            modules[name] = source
            waiting.extend(_imported(name, source))
    while True:
        pieces, lenders = _settings_pieces(modules, base)
        if not lenders - modules.keys():
            return modules, pieces
        # Without their packages, which gather what a piece of the configuration does not use.
        while lenders:
            name = lenders.pop()
            source = _module_file(name, base) if _counts(name) else None
            if source is not None and name not in modules:
                modules[name] = source
                lenders |= _imported(name, source)


@functools.cache
def _attributes_in(text: str, name: str) -> frozenset[str]:
    return frozenset(names_in(parsed(text, name))[1])


def _names_spoken(modules: dict[str, Path], base: Path) -> tuple[set[str], set[str]]:
    """Names in modules that may refer to a part of the configuration.

    Returns
    -------
    names : set of str
        What they import from the configuration's modules, or speak of as attributes of those.
    attributes : set of str
        All attributes.
    """
    names: set[str] = set()
    attributes: set[str] = set()
    imports_a_module = False
    for name, source in modules.items():
        attributes |= _attributes_in(_text(source), name)
        for member in _imports_in(name, source.name == "__init__.py", _text(source))[1]:
            module, _, imported = member.rpartition(".")
            if _is_settings(member) and _module_file(member, base):
                imports_a_module = True
            elif _is_settings(module):
                names.add(imported)
    return names | (attributes if imports_a_module else set()), attributes


def _settings_pieces(modules: dict[str, Path], base: Path) -> tuple[dict[str, list[str]], set[str]]:
    """What of the configuration counts for `modules`.

    Returns
    -------
    pieces : dict
        Of the configuration's modules, by name: the normal forms of what counts.
    lenders : set of str
        Modules from which these pieces take what they compute with. No catalogues: a rule compares
        what a stage uses of these.
    """
    sources = {
        module: source
        for source in sorted((base / PACKAGE).rglob("*.py"))
        if _is_settings(module := _module_name(source, base)) and module not in modules
    }
    unspoken = [
        (module, *piece)
        for module, source in sources.items()
        for piece in computing_definitions(_text(source), module)
    ]
    names, attributes = _names_spoken(modules, base)
    counting: dict[str, list[str]] = {}
    lenders: set[str] = set()
    while True:
        left: list[tuple] = []
        spoken: list[tuple] = []
        for piece in unspoken:
            _, name, is_member, _ = piece
            (spoken if name in (attributes if is_member else names) else left).append(piece)
        if not spoken:
            return {module: sorted(forms) for module, forms in counting.items()}, lenders
        unspoken = left
        for module, _, _, node in spoken:
            counting.setdefault(module, []).append(written(node))
            of_node = names_in(node)
            names |= of_node[0]
            attributes |= of_node[1]
            lenders |= _lenders(module, sources[module], of_node[0], base)


def _lenders(name: str, source: Path, spoken: set[str], base: Path) -> set[str]:
    """Modules that count, catalogues apart, from which a module imports one of the bare names."""
    found = set()
    for module, member, bound in _import_statements(
        name, source.name == "__init__.py", _text(source)
    ):
        if bound in spoken:
            inner = f"{module}.{member}"
            found.add(inner if member and _module_file(inner, base) else module)
    return {
        module
        for module in _of_the_package(found)
        if _counts(module) and not _is_in(module, CATALOGUES) and _module_file(module, base)
    }


def _data_files(modules: dict[str, Path], base: Path) -> set[Path]:
    """Files that are no sources, in the packages of `modules`, and that count."""
    found: set[Path] = set()
    for folder in {source.parent for source in modules.values()} - {base / PACKAGE}:
        found |= _files_in(folder)
    found -= {base / name for name in QUOTED}
    if not found:
        return found
    sources = {
        name: _text(source)
        for source in (base / PACKAGE).rglob("*.py")
        if not _is_in(name := _module_name(source, base), NOT_PART_OF_A_RESULT)
    }
    templates = {path: _text(path) for path in found if path.suffix == ".j2"}
    naming: dict[Path, set[str | Path]] = {
        path: {
            *(other for other, text in templates.items() if other != path and path.name in text),
            # In the text first: the normal form, which has no comments, takes longer.
            *(
                name
                for name, text in sources.items()
                if path.name in text and path.name in normal_form(text, name)
            ),
        }
        for path in found
    }
    reading: set[str | Path] = {name for name in modules if not _is_in(name, CATALOGUES)}
    counting: set[Path] = set()
    while True:
        more = {path for path in found - counting if not naming[path] or naming[path] & reading}
        if not more:
            return counting
        counting |= more
        reading |= more


def _files_in(package: Path) -> set[Path]:
    """Files that are no sources in a package and in those folders of it that are no packages."""
    found = set()
    for entry in package.iterdir():
        if entry.is_dir():
            if entry.name != "__pycache__" and not (entry / "__init__.py").exists():
                found |= _files_in(entry)
        elif not entry.name.endswith((".py", *IGNORED_SUFFIXES)) and entry.name[0] != ".":
            found.add(entry)
    return found


def _base(root: str | Path | None) -> Path:
    return Path(root) if root is not None else Path(__file__).resolve().parents[2]


def _contents(
    modules: dict[str, Path], pieces: dict[str, list[str]], base: Path
) -> dict[Path, bytes]:
    """The relevant content of each file, sorted by path below the root; from `_modules`."""
    contents = {path: path.read_bytes() for path in _data_files(modules, base)}
    for name, source in modules.items():
        form = without_entries if _is_in(name, CATALOGUES) else normal_form
        contents[source] = form(_text(source), name).encode()
    for name, forms in pieces.items():
        if file := _module_file(name, base):
            contents[file] = "\n".join(forms).encode()
    return dict(sorted(contents.items(), key=lambda item: item[0].relative_to(base).as_posix()))


def code_sources(stage: str, root: str | Path | None = None) -> list[Path]:
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
    base = _base(root)
    return list(_contents(*_modules(stage, base), base))


def _foreign(modules: Mapping[str, Path]) -> set[str]:
    """Packages whose versions count that `modules` import."""
    return {
        package
        for name, source in modules.items()
        for package in _imports_in(name, source.name == "__init__.py", _text(source))[2]
    }


@functools.cache
def installed_version(package: str) -> str | None:
    """Version of an installed package; None if it is not installed."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


@functools.cache
def code_digest(
    stage: str, root: str | Path | None = None, versions: tuple[tuple[str, str], ...] | None = None
) -> str:
    """SHA-256 over what computes in `stage` (64 hexadecimal digits): sources and versions.

    Deterministic: a function of the files' paths below the package, their contents and the versions
    of those `RESULT_PACKAGES` that they import. The answer is kept for the life of the process.

    Parameters
    ----------
    stage, root
        As for `code_sources`; the errors too.
    versions : tuple of pairs, optional
        Package and version, as a record names them; by default what is installed.
    """
    base = _base(root)
    digest = hashlib.sha256()
    modules, pieces = _modules(stage, base)
    for file, content in _contents(modules, pieces, base).items():
        digest.update(f"{file.relative_to(base).as_posix()}\0{len(content)}\0".encode())
        digest.update(content)
    stated = None if versions is None else dict(versions)
    for package in sorted(_foreign(modules)):
        version = installed_version(package) if stated is None else stated.get(package)
        digest.update(f"{package}=={str(version).partition('+')[0]}\0".encode())
    return digest.hexdigest()
