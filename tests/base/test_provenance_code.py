"""The digest of a stage's code: the sources that the stage imports, and no others."""

import pytest

from slipstitch.base.provenance import code

FILES = {
    "slipstitch/__init__.py": "",
    "slipstitch/base/errors.py": "WORDS = 1",
    "slipstitch/config/load.py": "MAXIMUM = 1",
    "slipstitch/images/__init__.py": "",
    "slipstitch/images/light.py": (
        '"""Light."""\nfrom slipstitch.config import load\nfrom slipstitch.images.lamp import W\n'
        "from slipstitch.base.errors import WORDS\nTABLE = 'table.json'\nimport bpy\n"
    ),
    "slipstitch/images/lamp.py": ('"""Lamp."""\nimport slipstitch.physics.fabric.law  # W\nW = 5'),
    "slipstitch/images/table.json": "[1]",
    "slipstitch/images/other.json": "[1]",
    "slipstitch/images/packing.py": "",
    "slipstitch/physics/fabric/law.py": "import slipstitch.images.light  # cycles do no harm",
    "slipstitch/physics/cloth.py": "",
}


@pytest.fixture
def tree(tmp_path):
    for name, content in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(content, encoding="utf-8")
    return tmp_path


def digest(stage, root, versions=None):
    code.code_digest.cache_clear()
    code._contents.cache_clear()
    return code.code_digest(stage, root, versions)


@pytest.mark.parametrize(
    ("file", "content", "counts"),
    [
        ("images/lamp.py", "import slipstitch.physics.fabric.law\nW = 6", True),
        ("images/lamp.py", "import slipstitch.physics.fabric.law\n\n\nW = 5  # W", False),
        ("images/lamp.py", '"""A lamp."""\nimport slipstitch.physics.fabric.law\nW = 5', False),
        ("images/table.json", "[2]", True),  # light.py names the table
        ("images/other.json", "[2]", False),
        ("physics/fabric/law.py", "import slipstitch.images.light\nC = 1", True),
        ("physics/cloth.py", "C = 1", False),
        ("base/errors.py", "WORDS = 2", False),
        ("config/load.py", "MAXIMUM = 2", False),
    ],
)
def test_what_is_imported_and_computes_counts(tree, file, content, counts):
    before = digest("render", tree)
    (tree / "slipstitch" / file).write_text(content, encoding="utf-8")
    assert (digest("render", tree) != before) == counts


def test_a_stage_of_one_module_ignores_its_neighbours_and_of_versions_the_build(tree):
    before = digest("render.packing", tree)
    (tree / "slipstitch/images/light.py").write_text("C = 1\nimport bpy", encoding="utf-8")
    assert digest("render.packing", tree) == before
    digests = [digest("render", tree, (("bpy", v),)) for v in ("4.5.0", "4.5.0+local", "4.5.1")]
    assert digests[0] == digests[1] != digests[2]
    for stage in ("rende", "simulate"):
        with pytest.raises(ModuleNotFoundError, match=f"no stage {stage} in"):
            digest(stage, tree)
