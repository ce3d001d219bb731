"""Cases of the benches, as the criticism reads and judges them."""

import json

import pandas as pd

from slipstitch.criticise.case import read_case
from slipstitch.criticise.measurements import assemble
from slipstitch.criticise.verdict import analyse
from slipstitch.criticise.verdict_data import verdict_of


def measured(folder):
    """The features of a case."""
    return assemble(read_case(folder))


def judged(folder, replicates=100):
    """The analysis of a case."""
    return analyse(measured(folder), replicates=replicates)


def verdict_on(folder, replicates=100):
    """The verdict on a case as plain data, and the analysis behind the verdict."""
    case = read_case(folder)
    analysis = analyse(assemble(case), replicates=replicates)
    return verdict_of(case, analysis, 1, "test"), analysis


def change(path, **columns):
    """Other columns of a table, or functions of it that give them."""
    pd.read_csv(path).assign(**columns).to_csv(path, index=False)


def change_meta(folder, **values):
    """Other entries of meta.json; those of ``nominal`` beside what is there."""
    meta = json.loads((folder / "meta.json").read_text())
    nominal = meta["nominal"] | values.pop("nominal", {})
    (folder / "meta.json").write_text(json.dumps(meta | {"nominal": nominal} | values))
