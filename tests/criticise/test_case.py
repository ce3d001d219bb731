"""Bad input is one line that names file, row and column."""

import json
import os
import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from support.departures import planted

from slipstitch.base.errors import BadInput
from slipstitch.cli.main import main
from slipstitch.criticise.case import read_case

CASES = Path(__file__).parents[2] / "data" / "cases"


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sound")
    planted(3, folder, {}, "incline", "drag")
    return folder


@pytest.fixture
def case(sound, tmp_path):
    return shutil.copytree(sound, tmp_path / "case")


def change(path, edit):
    table = pd.read_csv(path, dtype=str, keep_default_na=False)
    edit(table).to_csv(path, index=False)


def set_cell(row, column, value):
    def edit(table):
        table.loc[row, column] = value
        return table

    return edit


def test_parquet_does_as_well_as_csv(case):
    from_csv = read_case(case).tables["incline"]
    pd.read_csv(case / "incline.csv").to_parquet(case / "incline.parquet")
    (case / "incline.csv").unlink()
    pd.testing.assert_frame_equal(read_case(case).tables["incline"], from_csv)


def test_an_empty_cell_is_not_recorded_and_an_unknown_table_reported(case):
    change(case / "incline.csv", set_cell(2, "rh_pct", ""))
    (case / "peel.csv").write_text("a,b\n1,2\n")
    found = read_case(case)
    assert found.protocols == ("incline", "drag")
    assert found.ignored_files == ("peel.csv",)
    assert found.tables["incline"]["angle_deg"].notna().all()
    assert found.tables["incline"]["rh_pct"].isna().tolist()[2]


BAD_CELLS = [
    ("incline.csv", set_cell(4, "angle_deg", "500"), ["incline.csv", "row 6", "angle_deg", "500"]),
    ("incline.csv", set_cell(0, "angle_deg", "wet"), ["incline.csv", "row 2", "angle_deg", "wet"]),
    ("incline.csv", set_cell(1, "angle_deg", ""), ["incline.csv", "row 3", "angle_deg", "empty"]),
    ("incline.csv", set_cell(3, "run_id", "a000"), ["incline.csv", "row 5", "run_id", "a000"]),
    ("incline.csv", lambda t: t.drop(columns="u_angle_deg"), ["incline.csv", "u_angle_deg"]),
    ("incline.csv", lambda t: t.iloc[:0], ["incline.csv", "no rows"]),
    ("drag_runs.csv", set_cell(0, "rh_pct", "140"), ["drag_runs.csv", "row 2", "rh_pct", "100"]),
    ("drag.csv", set_cell(0, "run_id", "zz"), ["drag.csv", "row 2", "run_id", "zz"]),
    ("drag.csv", set_cell(5, "force_mN", "nan"), ["row 7", "force_mN", "leave the cell"]),
    ("drag.csv", lambda t: t[t["run_id"] != t["run_id"][0]], ["drag_runs.csv", "no rows"]),
]


@pytest.mark.parametrize("file, edit, words", BAD_CELLS)
def test_bad_tables_are_refused_in_one_line(case, file, edit, words):
    change(case / file, edit)
    with pytest.raises(BadInput) as caught:
        read_case(case)
    assert "\n" not in str(caught.value)
    for word in words:
        assert word in str(caught.value)


def change_meta(case, edit):
    meta = json.loads((case / "meta.json").read_text())
    edit(meta)
    (case / "meta.json").write_text(json.dumps(meta))


@pytest.mark.parametrize(
    "edit, words",
    [
        (lambda meta: meta["nominal"].pop("k_tether_N_m"), "k_tether_N_m"),
        (lambda meta: meta["protocols"].append("peel"), "protocols: unknown protocol 'peel'"),
    ],
)
def test_meta_without_a_value_or_with_an_unknown_protocol_is_refused(case, edit, words):
    change_meta(case, edit)
    with pytest.raises(BadInput, match=rf"meta\.json: .*{words}"):
        read_case(case)


@pytest.mark.parametrize("key", ["rho_kg_m2", "k_tether_N_m"])  # one that (a) needs, one of (c)
@pytest.mark.parametrize("value", [True, float("nan"), -50, "0.2"])
def test_what_is_no_positive_number_is_refused_whatever_needs_it(case, key, value):
    change_meta(case, lambda meta: meta["nominal"].update({key: value}))
    with pytest.raises(BadInput, match=rf"nominal\.{key}: {value!r}; must be a positive number"):
        read_case(case)


def test_an_areal_mass_that_no_protocol_needs_is_refused_all_the_same(tmp_path, capsys):
    folder = tmp_path / "case"
    shutil.copytree(CASES / "block_on_wood_board", folder)
    change_meta(folder, lambda meta: meta["nominal"].update(rho_kg_m2=-50))
    assert main(["criticise", str(folder), "--out", str(tmp_path / "v.json")]) == 2
    error = capsys.readouterr().err.strip()
    assert "nominal.rho_kg_m2: -50; must be a positive number" in error
    assert "\n" not in error


def pipe(path):
    path.unlink()
    os.mkfifo(path)


@pytest.mark.parametrize(
    "name, spoil, words",
    [
        ("meta.json", pipe, "not a file"),
        ("incline.csv", pipe, "not a file"),
        ("incline.csv", lambda path: path.write_bytes(path.read_bytes() + bytes(9)), "NUL bytes"),
        ("incline.csv", lambda path: os.truncate(path, 3 * 2**30), "larger than 512 MiB"),
        *((name, Path.unlink, "") for name in ("meta.json", "drag.csv", "incline.csv")),
    ],
)
def test_what_is_no_file_that_can_be_read_is_named(case, name, spoil, words):
    spoil(case / name)
    with pytest.raises(BadInput, match=rf"{re.escape(name)}.*{words}"):
        read_case(case)


@pytest.mark.parametrize("with_time", [True, False])
def test_the_order_of_a_traces_rows_does_not_matter(case, with_time):
    if not with_time:
        change(case / "drag.csv", lambda t: t.assign(t_s=""))
    columns = ["run_id", "stroke", "x_stage_mm", "force_mN"]
    ordered = read_case(case).tables["drag"].groupby("run_id")[columns]
    change(case / "drag.csv", lambda t: t.sample(frac=1, random_state=1))
    shuffled = read_case(case).tables["drag"].groupby("run_id")[columns]
    for run, rows in ordered:
        again = shuffled.get_group(run)
        for stroke in (0, 1):
            pd.testing.assert_frame_equal(
                again[again["stroke"] == stroke].reset_index(drop=True),
                rows[rows["stroke"] == stroke].reset_index(drop=True),
            )


def test_numbers_may_be_padded_and_lines_blank(case):
    expected = read_case(case).tables["incline"]
    change(case / "incline.csv", lambda t: t.assign(angle_deg=" " + t["angle_deg"] + "\u00a0"))
    with (case / "incline.csv").open("a") as file:
        file.write("\n" + "," * (len(expected.columns) - 1) + "\n \n")
    pd.testing.assert_frame_equal(read_case(case).tables["incline"], expected)


def test_dates_and_lists_in_parquet_are_refused(case):
    table = pd.read_csv(case / "incline.csv")
    for column, cells in (
        ("angle_deg", pd.Timestamp("2020-01-01")),
        ("run_id", [np.array([1, 2])] * len(table)),
    ):
        table.assign(**{column: cells}).to_parquet(case / "incline.parquet")
        (case / "incline.csv").unlink(missing_ok=True)
        with pytest.raises(BadInput, match=column):
            read_case(case)
