"""The workflow's files go into the wheel; everything else is in pyproject.toml."""

import shutil
import sys
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

ROOT = Path(__file__).parent
sys.path.insert(0, str(ROOT / "src"))

from slipstitch.base.project import INSTALLED, copy_parts  # noqa: E402


class WithWorkflow(build_py):
    """Builds the package and lays the workflow beside it."""

    def run(self):
        """Copy; an editable installation finds the checkout instead."""
        super().run()
        if not self.editable_mode:
            target = Path(self.build_lib) / INSTALLED
            shutil.rmtree(target, ignore_errors=True)  # of a build before
            copy_parts(ROOT, target)


setup(cmdclass={"build_py": WithWorkflow})
