"""The digest of a stage's code: the sources that it imports, and no others."""

import subprocess
import sys

import pytest

from slipstitch.provenance import code, code_digest, code_sources

FILES = {
    "slipstitch/__init__.py": "",
    "slipstitch/command.py": "import slipstitch.render.command",
    "slipstitch/errors.py": "",
    "slipstitch/config/__init__.py": "import slipstitch.train.settings",
    "slipstitch/render/__init__.py": "",
    "slipstitch/render/command.py": (
        "import json\nfrom slipstitch.config import load\n"
        "def run():\n    from . import images\n    from slipstitch.errors import BadInput\n"
    ),
    "slipstitch/render/images.py": "from ..simulate.trajectory import read",
    "slipstitch/render/data/table.csv": "1,2",
    "slipstitch/simulate/__init__.py": "",
    "slipstitch/simulate/trajectory.py": "import slipstitch.material as material",
    "slipstitch/simulate/solver.py": "import slipstitch.cloth",
    "slipstitch/material/__init__.py": "from slipstitch.material.law import *",
    "slipstitch/material/law.py": "import slipstitch.render",  # a cycle must not matter
    "slipstitch/material/fabrics.json": "{}",
    "slipstitch/cli/__init__.py": "",
    "slipstitch/cli/render.py": "import slipstitch.render.images",
    "slipstitch/cloth/__init__.py": "",
    "slipstitch/train/__init__.py": "",
    "slipstitch/train/settings.py": "",
}
OF_RENDER = {
    "slipstitch/material/__init__.py",
    "slipstitch/material/fabrics.json",
    "slipstitch/material/law.py",
    "slipstitch/render/__init__.py",
    "slipstitch/render/command.py",
    "slipstitch/render/data/table.csv",
    "slipstitch/render/images.py",
    "slipstitch/simulate/__init__.py",
    "slipstitch/simulate/trajectory.py",
}


def make(root):
    for name, content in FILES.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content, encoding="utf-8")
    return root


def digest(stage, root):
    code_digest.cache_clear()
    return code_digest(stage, root)


@pytest.fixture
def tree(tmp_path):
    return make(tmp_path / "src")


def test_sources_are_the_package_and_what_it_imports(tree):
    found = {path.relative_to(tree).as_posix() for path in code_sources("render", tree)}
    assert found == OF_RENDER


@pytest.mark.parametrize("name", sorted(FILES))
def test_digest_changes_with_each_of_these_and_with_no_other(tree, name):
    before = digest("render", tree)
    (tree / name).write_text(FILES[name] + "\nEDITED = 1\n", encoding="utf-8")
    assert (digest("render", tree) != before) == (name in OF_RENDER)


def test_new_module_of_the_package_counts(tree):
    before = digest("render", tree)
    (tree / "slipstitch/render/extra.py").write_text("")
    assert digest("render", tree) != before


def test_compiled_files_do_not_count(tree):
    before = digest("render", tree)
    cache = tree / "slipstitch/render/__pycache__"
    cache.mkdir()
    (cache / "images.cpython-311.pyc").write_bytes(b"x")
    (tree / "slipstitch/render/left.pyc").write_bytes(b"x")
    assert digest("render", tree) == before


def test_digest_depends_on_names_and_contents_only(tree, tmp_path):
    assert digest("render", tree) == digest("render", make(tmp_path / "elsewhere"))


def test_moving_code_between_files_changes_the_digest(tree):
    before = digest("render", tree)
    (tree / "slipstitch/render/images.py").rename(tree / "slipstitch/render/pictures.py")
    assert digest("render", tree) != before


def test_unknown_stage_is_an_error(tree):
    with pytest.raises(ModuleNotFoundError, match=r"slipstitch\.rende"):
        code_sources("rende", tree)


def test_a_table_counts_where_it_is_named_or_where_no_module_names_any(tree):
    before = digest("render", tree)
    # A module that render never imports is the only one that names it.
    (tree / "slipstitch/material/other.py").write_text("FILE = 'fabrics.json'", encoding="utf-8")
    assert digest("render", tree) != before
    assert "fabrics.json" not in {path.name for path in code_sources("render", tree)}
    law = tree / "slipstitch/material/law.py"
    law.write_text(law.read_text() + "\nFILE = 'fabrics.json'", encoding="utf-8")
    assert "fabrics.json" in {path.name for path in code_sources("render", tree)}


CONFIGURATION = '''
from typing import Annotated
from pydantic import BaseModel, Field, field_validator
Size = Annotated[int, Field(ge=1)]
class Settings(BaseModel):
    """Words."""
    pixels: Size = Field(64, ge=16, description="of the image")
    @property
    def side(self): return _half(self.pixels) * 2
    def unused(self): return 3
    @field_validator("pixels")
    def _even(cls, value): return value
def _half(x): return x / 2
'''


@pytest.mark.parametrize(
    ("old", "new", "reruns"),
    [
        ("* 2", "* 3", True),
        ("x / 2", "x / 4", True),
        ("return 3", "return 4", False),
        ("of the image", "of the images", False),
        ("ge=16", "ge=8", False),
        ("ge=1)", "ge=2)", False),
        ("64", "32", False),  # compared as a value
        ("    @property", "    more: int = 1\n    @property", False),
        ("return value", "return value + 0", False),
        ("Words", "Other words", False),
    ],
)
def test_the_configuration_counts_where_it_computes(tree, old, new, reruns):
    (tree / "slipstitch/config/images.py").write_text(CONFIGURATION, encoding="utf-8")
    (tree / "slipstitch/render/images.py").write_text(
        "def draw(settings): return settings.side", encoding="utf-8"
    )
    before = {stage: digest(stage, tree) for stage in ("render", "train")}
    assert CONFIGURATION.count(old) == 1
    edited = CONFIGURATION.replace(old, new)
    (tree / "slipstitch/config/images.py").write_text(edited, encoding="utf-8")
    assert (digest("render", tree) != before["render"]) == reruns
    assert digest("train", tree) == before["train"]


BORROWING = """
from slipstitch.errors import BadInput
from slipstitch.material import law
from slipstitch.theory.drag import reach
from slipstitch.theory.sag import drop
from slipstitch.gone import nothing
def side(): return reach() + law.SLOPE + nothing
def height(): return drop()
"""


@pytest.mark.parametrize(
    ("name", "reruns"),
    [
        ("theory/drag.py", True),  # a function that render speaks of takes it from there
        ("theory/domain.py", True),  # which imports this
        ("material/law.py", True),
        ("theory/sag.py", False),  # of another function of the same module
        ("theory/__init__.py", False),
        ("errors.py", False),
    ],
)
def test_what_the_configuration_computes_with_counts_where_it_does(tree, name, reruns):
    files = {
        "config/images.py": BORROWING,
        "render/__init__.py": "",
        "render/command.py": "from slipstitch.config.images import side",
        "render/images.py": "",
        "theory/__init__.py": "from slipstitch.theory.sag import drop",
        "theory/drag.py": "from slipstitch.theory.domain import require",
        "theory/domain.py": "",
        "theory/sag.py": "",
        "material/law.py": "",
    }
    (tree / "slipstitch/theory").mkdir()
    for file, content in files.items():
        (tree / "slipstitch" / file).write_text(content, encoding="utf-8")
    before = {stage: digest(stage, tree) for stage in ("render", "train")}
    path = tree / "slipstitch" / name
    path.write_text(path.read_text(encoding="utf-8") + "\nEDITED = 1\n", encoding="utf-8")
    assert (digest("render", tree) != before["render"]) == reruns
    assert digest("train", tree) == before["train"]


def test_versions_that_change_results_count_where_they_are_imported(tree, monkeypatch):
    law = tree / "slipstitch/material/law.py"
    law.write_text(law.read_text() + "\nimport warp as wp\nimport numpy\n", encoding="utf-8")
    before = digest("render", tree), digest("train", tree)
    monkeypatch.setattr(code, "installed_version", lambda package: "9.9+cu128")
    after = digest("render", tree), digest("train", tree)
    assert after[0] != before[0]
    assert after[1] == before[1]
    # As a record states it, without the name of the build.
    assert code_digest("render", tree, (("numpy", "1"), ("warp-lang", "9.9"))) == after[0]
    code_digest.cache_clear()


def test_digest_of_the_real_stages_is_the_same_in_another_process():
    stages = ("simulate", "render", "train")
    code = f"from slipstitch.provenance import code_digest; print(*map(code_digest, {stages}))"
    answer = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    code_digest.cache_clear()
    assert answer.stdout.split() == [code_digest(stage) for stage in stages]


def test_real_stages_depend_on_the_versions_that_change_their_results():
    base = code._base(None)
    needed = {
        stage: code._foreign(code._modules(stage, base)[0])
        for stage in ("simulate", "calibrate", "render", "render.packing", "train", "sample")
    }
    assert needed["simulate"] == needed["calibrate"] == {"warp-lang"}
    assert needed["render"] == needed["render.packing"] == {"bpy", "warp-lang"}
    assert needed["train"] == {"torch"}
    assert needed["sample"] == set()


def test_real_stages_do_not_depend_on_later_ones():
    # Else editing a network would throw the simulations away.
    later = {
        "simulate": ("render", "sample", "train", "evaluate", "report"),
        "render": ("train", "evaluate", "report", "cloth"),
        "sample": ("evaluate", "report"),
        "train": ("evaluate", "report"),
    }
    for stage, packages in later.items():
        folders = {path.parent.name for path in code_sources(stage)}
        assert not folders & set(packages), stage
