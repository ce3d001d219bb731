"""Digest of the code of a stage: the source files that compute its result.

A stage is rerun when its digest changes. The digest covers the modules named in `STAGES` and every
module that they import, directly or through others. Of a module counts what
`ast.unparse` writes of it without docstrings: comments, layout and documentation do not count.
Settings do not count either: their values are parameters of the rules.
"""

import ast
import functools
import hashlib
from pathlib import Path

from slipstitch.base.project import installed_version

PACKAGE, RUNNING = "slipstitch", Path(__file__).resolve().parents[3]

# Stage, as rules and records name it -> modules or packages below `slipstitch` that it starts from.
STAGES: dict[str, tuple[str, ...]] = {
    "grid": ("design.grid",),
    "calibrate": ("physics.calibration",),
    "calibrate.sweep": ("physics.calibration.sweep",),
    "calibrate.calibration": ("physics.calibration.calibration",),
    "calibrate.pictures": ("physics.calibration.pictures",),
    "convergence": ("physics.convergence",),
    "convergence.case_run": ("physics.convergence.cases",),
    "simulate": ("physics.simulation",),
    "protocol": ("physics.experiments",),
    "render": ("images",),
    "render.packing": ("images.packing",),
    "sample": ("dataset.dataset", "dataset.probes"),
    "train": ("learning.lrcn_training",),
    "instrument": ("learning.instrument",),
    "evaluate": ("learning.evaluation.evaluation",),
    "evaluate.captures": ("film.captures_evaluation",),
    "ablate": ("learning.ablation",),
    "ablate.run": ("learning.ablation.run",),
    "release": ("dataset.release",),
    "audit": ("dataset.audit",),
    "report": ("report.page",),
    "publish": ("report.publishing",),
    "capture": (
        "film.camera_calibration",
        "film.ingest_videos",
        "film.slip_angles",
        "film.surrogates",
    ),
    "measure": ("film.measure",),
    "criticise": ("criticise",),
    "predict": ("criticise.prediction",),
}

# Modules that decide which values reach a stage, or write down what happened.
NOT_COUNTED = ("cli", "config", "base.errors", "base.progress", "base.provenance", "base.start")
# Tables whose entries are compared one by one, as parameters of the rules that use them.
QUOTED = ("fabrics.json", "convergence.json")
# Module -> the package whose version changes the results of a stage that imports the module.
RESULT_PACKAGES = {"bpy": "bpy", "torch": "torch", "warp": "warp-lang"}


def _sources(root: Path, module: str) -> list[Path]:
    """Files of a module or of all modules of a package; empty if there is neither."""
    place = root / PACKAGE / Path(*module.split("."))
    if place.is_dir():
        return sorted(place.rglob("*.py"))
    return [file] if (file := place.with_suffix(".py")).is_file() else []


@functools.cache
def _read(text: str) -> tuple[str, frozenset[str]]:
    """Computing text of a module, and the dotted names that the module imports."""
    tree = ast.parse(text)
    imported: set[str] = set()
    for node in ast.walk(tree):
        documented = (ast.Module, ast.ClassDef, ast.FunctionDef)
        if isinstance(node, documented) and ast.get_docstring(node):
            node.body[:1] = [] if len(node.body) > 1 else [ast.Pass()]
        if isinstance(node, ast.Import):
            imported |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            imported |= {f"{node.module}.{alias.name}" for alias in node.names}
    return ast.unparse(tree), frozenset(imported)


def _imported_sources(root: Path, name: str) -> list[Path]:
    """Source of an imported name, which is a module, a package or something inside of either."""
    parts = name.split(".")[1:]
    for length in (len(parts), len(parts) - 1):
        module = ".".join(parts[:length])
        if any(module == one or module.startswith(one + ".") for one in NOT_COUNTED) or not module:
            return []
        place = root / PACKAGE / Path(*parts[:length])
        for file in (place.with_suffix(".py"), place / "__init__.py"):
            if file.is_file():
                return [file]
    return []


@functools.cache
def _contents(stage: str, root: Path) -> tuple[dict[Path, str], frozenset[str]]:
    """Computing text of every file that counts, and the packages whose versions count."""
    waiting = [file for module in STAGES.get(stage, ()) for file in _sources(root, module)]
    if not waiting:
        raise ModuleNotFoundError(f"no stage {stage} in {root}")
    contents: dict[Path, str] = {}
    versions: set[str] = set()
    while waiting:
        file = waiting.pop()
        if file in contents:
            continue
        contents[file], imported = _read(file.read_text(encoding="utf-8"))
        versions |= {RESULT_PACKAGES.get(name.partition(".")[0], "") for name in imported} - {""}
        for name in imported:
            if name.startswith(PACKAGE + "."):
                waiting += _imported_sources(root, name)
    tables = {
        data
        for folder in {file.parent for file in contents}
        for data in folder.iterdir()
        if data.suffix in (".j2", ".json", ".css") and data.name not in QUOTED
    }
    texts = list(contents.values())
    while named := [data for data in tables if any(data.name in text for text in texts)]:
        tables.difference_update(named)
        texts = [data.read_text(encoding="utf-8") for data in named]  # they may name others
        contents.update(zip(named, texts, strict=True))
    ordered = sorted(contents, key=lambda file: file.relative_to(root).as_posix())
    return {file: contents[file] for file in ordered}, frozenset(versions)


@functools.cache
def code_digest(
    stage: str, root: str | Path | None = None, versions: tuple[tuple[str, str], ...] | None = None
) -> str:
    """Return the SHA-256 of a stage's code: sources, and versions, by default those installed.

    The root is the folder that holds the package, the running one by default.
    """
    base = Path(root or RUNNING)
    contents, packages = _contents(stage, base)
    digest = hashlib.sha256()
    for file, text in contents.items():
        digest.update(f"{file.relative_to(base).as_posix()}\0{len(text)}\0{text}".encode())
    stated = None if versions is None else dict(versions)
    for package in sorted(packages):
        version = installed_version(package) if stated is None else stated.get(package)
        digest.update(f"{package}=={str(version).partition('+')[0]}\0".encode())
    return digest.hexdigest()
