"""A captures table measured: each pair's videos together, with what its rows tell of the bench."""

import csv
import json
import shutil

import pytest
from support import analytic_stage as stage
from support import example_film
from support.refusal import refused, run

from slipstitch.film.measure import EXAMPLE_CAMERA, EXAMPLE_VIDEO

HEADER = (
    "video,material,substrate,repeat,camera,reflective,mu_ref,mu_ref_error,"
    "clamp_height_mm,clamp_height_error_mm,areal_density_g_m2,bending_length_mm"
)


@pytest.fixture
def bench(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copy(EXAMPLE_VIDEO, "a.mp4")
    shutil.copy(EXAMPLE_CAMERA, "camera.json")
    return tmp_path


def table(*rows):
    with open("captures.csv", "w", encoding="utf-8") as file:
        file.write("\n".join([HEADER, *rows]) + "\n")
    return "measure --captures captures.csv"


def test_every_pair_is_measured_with_what_its_rows_tell(bench, capsys):
    images, times_s = example_film.images_and_times()
    stage.write_video(bench / "b.mp4", images, times_s, preset="ultrafast", crf="24")
    (bench / "c.mp4").write_text("no video")
    command = table(
        "a.mp4,denim,glass,1,camera.json,no,0.2274,0.01,150.5,0.1,,",
        "c.mp4,denim,glass,2,camera.json,no,0.2274,0.01,,,,",
        "b.mp4,knit,steel,1,camera.json,no,,,,,640,21",
    )
    assert run(f"{command} --out p.html --json p.json --csv p.csv") == 2  # a video was refused
    denim, refusal, knit, alarm = capsys.readouterr().out.splitlines()
    assert denim.startswith("denim on glass: combined (1 of 2 videos): friction 0.2")
    assert denim.endswith("; reference 0.227 ± 0.010")
    assert refusal == "  not measured: c.mp4: a text file, not a video"
    assert knit == "knit on steel: ALARM in every video: no combined value"
    assert alarm.startswith("  ALARM in b.mp4: the fabric is too heavy: areal density 640 g/m²")

    first, second = json.loads((bench / "p.json").read_text())["pairs"]
    assert (first["material"], first["substrate"], first["mu_ref"]) == ("denim", "glass", 0.2274)
    assert (second["mu_ref"], second["combined"]) == (None, None)
    (told,), (other,) = first["videos"], second["videos"]
    assert (told["clamp_height_mm"], told["clamp_height_source"]) == (150.5, "told")
    assert told["clamp_height_error_mm"] == pytest.approx(0.1)
    assert told["areal_density_g_m2"] is None
    assert (other["areal_density_g_m2"], other["bending_length_mm"]) == (640, 21)
    # The same film: only the height that was told moves its reading.
    factor = told["clamp_height_factor"]
    assert factor > 1.02
    assert told["friction_coefficient"] == pytest.approx(
        factor * other["friction_coefficient"], rel=0.01
    )
    with (bench / "p.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["video"] for row in rows] == ["a.mp4", "c.mp4", "combined", "b.mp4"]
    assert [row["substrate"] for row in rows] == ["glass"] * 3 + ["steel"]
    page = (bench / "p.html").read_text()
    assert "150.5 ± 0.1 mm, told" in page and "areal density 640 g/m², bending length 21 mm" in page
    read = json.loads((bench / "p.json.provenance.json").read_text())["inputs"]
    assert {"captures.csv", "camera.json", "a.mp4", "b.mp4"} <= set(read)


@pytest.mark.parametrize(
    ("cells", "says"),
    [
        ("0.1505,0.1,,", "line 2: clamp height 0.1505 mm: must be from 148 to 152 mm"),
        ("150.5,0,,", "line 2, clamp_height_error_mm: '0'; must be a number above 0"),
        ("150.5,5,,", "line 2: error of the clamp height 5 mm: must be above 0 and at most 2 mm"),
        (",0.1,,", "line 2: error of the clamp height: give the clamp height with it"),
        (",,0.2,", "line 2: areal density 0.2: must be from 10 to 2000 g/m²"),
        (",,,600", "line 2: bending length 600: must be from 2 to 150 mm"),
        (",,,stiff", "line 2, bending_length_mm: 'stiff'; must be a number above 0"),
    ],
)
def test_what_cannot_be_of_a_bench_is_refused_before_a_video_is_read(bench, capsys, cells, says):
    command = table(f"a.mp4,denim,glass,1,camera.json,no,,,{cells}")
    said = refused(capsys, f"{command} --csv p.csv")
    assert f"captures.csv {says}" in said
    assert not (bench / "p.csv").exists()


def test_a_reference_has_its_error_and_a_table_its_own_videos(bench, capsys):
    row = "a.mp4,denim,glass,1,camera.json,no,{},,,,,"
    said = refused(capsys, table(row.format("0.3")))
    assert "mu_ref and mu_ref_error must be given together" in said
    command = table(row.format(""))
    assert "--captures has its own videos" in refused(capsys, f"{command} a.mp4")
    for option in ("--camera camera.json", "--clamp-height-mm 150", "--bending-length-mm 20"):
        flag = option.split()[0]
        said = refused(capsys, f"{command} {option}")
        assert f"{flag} cannot be combined with --captures" in said
    said = refused(capsys, f"{command} --json camera.json")
    assert "--json camera.json: captures.csv names this file" in said
    (bench / "a.mp4").write_text("no video")
    said = refused(capsys, command)
    assert "captures.csv: none of 1 videos can be measured; the first: a.mp4: a text file" in said
