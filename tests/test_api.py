"""The examples of docs/quickstart.md, one after the other, as a user would run them."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pyarrow.parquet as pq

ROOT = Path(__file__).parents[1]
EXAMPLES = re.findall(
    r"^```python\n(.*?)^```$",
    (ROOT / "docs/quickstart.md").read_text(encoding="utf-8"),
    re.M | re.S,
)


def test_the_examples_run_and_are_short(tmp_path):
    assert len(EXAMPLES) == 4
    assert all(len(example.splitlines()) <= 10 for example in EXAMPLES)
    answer = subprocess.run(
        [sys.executable, "-c", "\n".join(EXAMPLES)],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT / "src")},
        capture_output=True,
        text=True,
    )
    assert answer.returncode == 0, answer.stderr
    fallen, acceleration, verdict = answer.stdout.splitlines()
    assert abs(float(re.search(r"vertex (\S+) mm", fallen).group(1))) < 0.1  # on the floor
    measured, theory = map(float, acceleration.split())
    assert abs(measured - theory) < 1e-3 * theory
    assert verdict.startswith("Between the runs nothing beyond plain Coulomb friction")
    assert pq.read_metadata(tmp_path / "drop_v00.parquet").num_rows == 3
