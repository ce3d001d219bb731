"""A campaign's certificate: what it could have seen is what it sees."""

import numpy as np
from support.hidden_effects.bench import make_case

from slipstitch.criticise.case import read_case
from slipstitch.criticise.inference.analysis import SIGNIFICANCE, analyse
from slipstitch.criticise.inference.certificate import of_design
from slipstitch.criticise.measurements import assemble


def test_an_effect_well_above_the_smallest_detectable_is_seen_and_one_far_below_is_not(tmp_path):
    make_case(93, "null", tmp_path / "null", plant=({}, ["incline"]))
    null = analyse(assemble(read_case(tmp_path / "null")), replicates=100)
    assert null.verdict == "none"
    smallest = null.detectable["nap"].size
    assert 0.005 < smallest < 0.2
    for factor, seen in ((2.0, True), (0.2, False)):
        folder = tmp_path / f"{factor}"
        effects = {"nap": {"nap": factor * smallest}}
        make_case(93, "single", folder, plant=(effects, ["incline"]))
        found = analyse(assemble(read_case(folder)), replicates=100)
        assert (found.global_p < SIGNIFICANCE) == seen


def test_a_design_says_before_it_is_measured_what_it_could_show(tmp_path):
    make_case(93, "null", tmp_path, plant=({}, ["incline"]))
    for table in tmp_path.glob("incline.csv"):
        lines = table.read_text().splitlines()
        table.write_text("\n".join(lines[:13]) + "\n")
    few = of_design(assemble(read_case(tmp_path, False), False), SIGNIFICANCE, 1, 100)
    table.write_text("\n".join(lines) + "\n")
    all_ = of_design(assemble(read_case(tmp_path, False), False), SIGNIFICANCE, 1, 100)
    assert all_["nap"].size < few["nap"].size
    for found in [*few.values(), *all_.values()]:
        assert np.isinf(found.size) or found.on_friction < np.log(10)
    assert np.isinf(all_["backlash"].size) if "backlash" in all_ else True
