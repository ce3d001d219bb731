"""Spreadsheets of everywhere: read where they mean one thing, refused in one line where not."""

import json
import re

import numpy as np
import pandas as pd
import pytest

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import read_json
from slipstitch.base.tables import as_number, directions_in_radians, read_cells
from slipstitch.cli.main import main
from slipstitch.film.slip_angles import read_angles
from slipstitch.images.camera_file import read_camera_file
from slipstitch.physics.fabric import read_fabric_file

HEADER = "material,substrate,position,orientation,repeat,angle_deg,bench_error_deg"
ROWS = [f"Wölle,glass,{i},warp,1,{22.5 + 0.1 * i:.2f},0.2" for i in range(1, 6)]
PLAIN = "\n".join([HEADER, *ROWS]) + "\n"
GERMAN = PLAIN.replace(",", ";").replace(".", ",")
QUOTED = "\n".join([HEADER, *(re.sub(r"(\d+)\.(\d+)", r'"\1,\2"', row) for row in ROWS)])


def written(tmp_path, text, encoding="utf-8"):
    path = tmp_path / "angles.CSV"
    path.write_bytes(text.encode(encoding))
    return path


READ = {
    "plain": (PLAIN, "utf-8"),
    "semicolons and decimal commas": (GERMAN, "utf-8"),
    "tabs": (PLAIN.replace(",", "\t"), "utf-8"),
    "quoted decimal commas": (QUOTED, "utf-8"),
    "sep= line": ("sep=;\n" + GERMAN, "utf-8"),
    "latin-1": (GERMAN, "latin-1"),
    "byte-order mark": (PLAIN, "utf-8-sig"),
    "utf-16": (PLAIN, "utf-16"),
    "empty columns": (PLAIN.replace("\n", ",,\n"), "utf-8"),
    "units": (PLAIN.replace("_deg\n", "_deg\n,,,,,[deg],°\n"), "utf-8"),
    "titles": ("Report of 2026\n\n" + PLAIN, "utf-8"),
}  # fmt: skip


@pytest.mark.parametrize("text, encoding", READ.values(), ids=READ)
def test_one_meaning_is_read(text, encoding, tmp_path):
    (pair,) = read_angles(written(tmp_path, text, encoding))
    assert (pair.material, len(pair.position)) == ("Wölle", 5)
    assert np.degrees(pair.angle_rad) == pytest.approx(22.5 + 0.1 * np.arange(1, 6))


REFUSED = {
    "commas for both": (PLAIN.replace(".", ","), "commas between cells and in numbers"),
    "both marks": (GERMAN.replace("22,70", "22.70"), "decimal commas .* and decimal points"),
    "thousands": (PLAIN.replace("0.2\n", '"1,200"\n').replace(".", ""), "or thousands"),
    "twice": (PLAIN.replace("position", "angle_deg"), "column angle_deg: given twice"),
    "another unit": (PLAIN.replace("_deg\n", "_deg\n,,,,,rad,\n"), "in rad by its unit"),
    "radians": (re.sub(r",2[23]\.\d", ",0.4", PLAIN), "angles in radians"),
    "underscores": (PLAIN.replace("22.60", "2_2.5"), "2_2.5"),
    "open quotation": (PLAIN.replace("Wölle", '"W', 1), "quotation mark is not closed"),
}


@pytest.mark.parametrize("text, words", REFUSED.values(), ids=REFUSED)
def test_two_meanings_are_refused_in_one_line(text, words, tmp_path):
    with pytest.raises(BadInput, match=words) as caught:
        read_angles(written(tmp_path, text))
    assert "\n" not in str(caught.value)


def test_another_encoding_is_named_with_the_way_out(tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes(b"t_s,force_mN\n" + bytes(range(0x81, 0xFF)))
    with pytest.raises(BadInput, match="encoding is not UTF-8; export as CSV in UTF-8"):
        read_cells(path, ["t_s"], 1e6)


@pytest.mark.parametrize(
    "read, content",
    [
        (read_json, {"models": 1}),
        (read_camera_file, {"format": "another"}),
        (read_fabric_file, {"fabrics": {}}),
    ],
)
def test_a_byte_order_mark_in_json_changes_nothing(read, content, tmp_path):
    said = []
    for encoding in ("utf-8", "utf-8-sig"):
        (tmp_path / "a.json").write_text(json.dumps(content), encoding=encoding)
        try:
            said.append(read(tmp_path / "a.json"))
        except BadInput as error:
            said.append(str(error))
    assert said[0] == said[1]
    assert said[0] == content or said[0] == {} or "its format is not" in said[0]


@pytest.mark.parametrize("text", ["2_2.5", "0x1A", "１２", "nan", "1 000", "", "1,5"])
def test_what_people_do_not_write_is_no_number(text):
    with pytest.raises(ValueError):
        as_number(text)


@pytest.mark.parametrize(
    "angles, radians",
    [([0, np.pi / 2], True), ([0.785, 3.142], True), ([0, 90], False), ([0, 0], False),
     ([1, 2, 3], False)],
)  # fmt: skip
def test_directions_in_radians_are_told(angles, radians):
    assert directions_in_radians(angles) == radians


EXPORT = '"Prüfung"\n\n"Zeit";"Traverse";"Kraft"\n"s";"mm";"{unit}"\n'


@pytest.mark.parametrize("unit, worth", [("N", 1e3), ("kN", 1e6), ("mN", 1.0)])
@pytest.mark.parametrize("encoding", ["utf-8", "latin-1"])
def test_a_testing_machines_export_becomes_a_trace(unit, worth, encoding, tmp_path):
    lines = [f'"{0.04 * i:.2f}";"{4 - abs(4 - i):.1f}";"{0.5 * i:.2f}"' for i in range(9)]
    path = tmp_path / "export.csv"
    text = EXPORT.format(unit=unit) + "\n".join(lines).replace(".", ",")
    path.write_bytes(text.encode(encoding))
    words = ["capture", "trace", str(path), "--out", str(tmp_path / "t.csv"), "--columns"]
    columns = "time=Zeit,force=Kraft,extension=Traverse"
    assert main([*words, columns, "--units", unit]) == 0
    trace = pd.read_csv(tmp_path / "t.csv")
    assert trace["force_mN"].to_numpy() == pytest.approx(0.5 * worth * np.arange(9))
    assert trace["stroke"].tolist() == [0] * 5 + [1] * 4
    assert trace["t_s"].iloc[-1] == pytest.approx(0.32)


GIVEN = EXPORT.format(unit="N") + "0;0;0\n1;1;1\n"
BACK = "Zeit,Kraft\n0,1\n0.1,1\n0.2,1\n0.1,1\n0.2,1\n"
TWICE = "Zeit,Kraft\n0,1\n0,1\n0,1\n0.1,1\n0.1,1\n"
FORCE = "time=Zeit,force=Kraft"


@pytest.mark.parametrize(
    "text, columns, units, code, words",
    [
        (GIVEN, FORCE, "cN", 2, "force in N by its row of units, not in cN"),
        (GIVEN, "time=Zeit,force=Last", "N", 2, "no column 'Last'; there are: Zeit, Traverse, Kra"),
        (GIVEN, "time=Zeit,pull=Kraft", "N", 2, "pull: unknown"),
        (GIVEN, "force=Kraft", "N", 2, "a force and a time"),
        (GIVEN, FORCE, "Newton", 2, "--units: Newton: unknown"),
        (BACK, FORCE, "N", 0, "its clock steps back 1 time(s), as where parts were joined"),
        (TWICE, FORCE, "N", 0, "3 of 5 readings are at the time of the one before"),
    ],
)
def test_what_an_import_refuses_or_leaves_open_is_said(
    text, columns, units, code, words, tmp_path, capsys
):
    (tmp_path / "export.csv").write_text(text)
    arguments = ["--columns", columns, "--units", units, "--out", str(tmp_path / "t.csv")]
    assert main(["capture", "trace", str(tmp_path / "export.csv"), *arguments]) == code
    said = capsys.readouterr().err.strip()
    assert words in said and (code == 0 or "\n" not in said)
