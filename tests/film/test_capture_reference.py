"""``slipstitch capture reference``: friction from slip angles, with an error that holds."""

import csv
import json
import os
import subprocess
import sys

import numpy as np
import pytest
from support.refusal import refused

from slipstitch.base.errors import BadInput
from slipstitch.film.slip_angles import SlipAngles, estimate

HEADER = "material,substrate,position,orientation,repeat,angle_deg,bench_error_deg"


def measured(rng, mu=0.4, tau=0.02, sigma=0.015, bench_deg=0.0, cells=None, along=(0.0, 0.0)):
    """Slip angles of a made-up pair: positions x orientations x repeats, or the cells given."""
    cells = cells or [(p, o) for p in range(5) for o in range(2) for _ in range(2)]
    place = rng.normal(0, tau, 1 + max(p for p, _ in cells))
    values = [mu + place[p] + along[o] + rng.normal(0, sigma) for p, o in cells]
    bias = rng.uniform(-1, 1) * np.radians(bench_deg)
    return SlipAngles(
        "gray-interlock",
        "glass",
        [f"place {p}" for p, _ in cells],
        ["weft" if o else "warp" for _, o in cells],
        np.arctan(values) + bias,
        float(np.radians(bench_deg)),
    )


def test_a_balanced_table_gives_students_interval_of_the_positions_means():
    """Closed form: of independent, equally exact means, t with one degree of freedom fewer."""
    for seed in range(20):  # the estimate of tau^2 is negative in some
        angles = measured(np.random.default_rng(seed), tau=0.004)
        means = np.tan(angles.angle_rad).reshape(5, 4).mean(axis=1)
        found = estimate(angles)
        assert found.mu == pytest.approx(means.mean(), abs=1e-9)
        assert found.standard_error == pytest.approx(means.std(ddof=1) / np.sqrt(5), rel=1e-3)
        assert found.degrees_of_freedom == pytest.approx(4, rel=1e-2)
        assert found.error == pytest.approx(2.7764 * found.standard_error, rel=5e-3)


@pytest.mark.parametrize("cells", [[(0, 0)] * 6, [(p, 0) for p in range(6)]])
def test_without_repeats_at_several_positions_it_is_plain_students_interval(cells):
    """What positions scatter and what repeats do is in one number then, and need not be told."""
    angles = measured(np.random.default_rng(1), cells=cells)
    values = np.tan(angles.angle_rad)
    found = estimate(angles)
    assert found.mu == pytest.approx(values.mean())
    assert found.standard_error == pytest.approx(values.std(ddof=1) / np.sqrt(6))
    assert found.degrees_of_freedom == pytest.approx(5)
    assert (found.position_sd, found.position_p, found.orientation_p) == (None, None, None)
    # An orientation at one position only cannot be told from it.
    angles = measured(np.random.default_rng(1), cells=[(0, 0)] * 4 + [(1, 1)] * 4)
    with pytest.raises(BadInput, match="gray-interlock on glass: the effects of positions, orien"):
        estimate(angles)


@pytest.mark.parametrize("bench_deg", [0.0, 0.5])
@pytest.mark.parametrize("cells", [None, [(p, o) for p in range(6) for o in range(2)][1:]
                                   + [(0, 0)] * 3 + [(2, 1)] * 2])  # fmt: skip
def test_the_interval_covers_the_truth_as_often_as_it_says(cells, bench_deg):
    """Balanced and not, with the bench's error and without: 95 % of 200 tables, to 3 sigma."""
    rng = np.random.default_rng(11)
    hits = 0
    for _ in range(200):
        found = estimate(measured(rng, bench_deg=bench_deg, cells=cells, along=(0.02, -0.02)))
        hits += abs(found.mu - 0.4) <= found.error
    assert hits / 200 == pytest.approx(0.95, abs=0.046)


def test_the_benchs_error_does_not_average_out():
    cells = [(p, o) for p in range(8) for o in range(2) for _ in range(20)]
    found = estimate(measured(np.random.default_rng(0), tau=0.001, bench_deg=0.5, cells=cells))
    alone = (1 + 0.4**2) * np.radians(0.5)
    assert found.bench_error == pytest.approx(alone, rel=0.03)
    assert found.error > 0.95 * found.bench_error


def test_positions_and_orientations_that_differ_are_told():
    rng = np.random.default_rng(5)
    same = estimate(measured(rng, tau=0.0, sigma=0.01))
    nap = estimate(measured(rng, tau=0.0, sigma=0.01, along=(0.03, -0.03)))
    patchy = estimate(measured(rng, tau=0.05, sigma=0.01))
    assert min(same.position_p, same.orientation_p) > 0.01
    assert nap.orientation_p < 1e-4 < nap.position_p
    assert patchy.position_p < 1e-4 < patchy.orientation_p
    assert nap.by_orientation["warp"][0] - nap.by_orientation["weft"][0] == pytest.approx(
        0.06, abs=0.02
    )
    assert patchy.position_sd == pytest.approx(0.05, rel=0.7)
    # F tests reject equal means as rarely as they say.
    p = [estimate(measured(rng, tau=0.0)).position_p for _ in range(200)]
    assert np.mean(np.array(p) < 0.1) == pytest.approx(0.1, abs=0.065)


def write(folder, *rows):
    path = folder / "angles.csv"
    path.write_text("\n".join([HEADER, *rows]) + "\n")
    return path


def rows_of(substrate, mu, rng):
    for position in "ABC":
        for orientation in ("0", "90"):
            for repeat in range(2):
                angle = np.degrees(np.arctan(mu + rng.normal(0, 0.01)))
                yield f"denim,{substrate},{position},{orientation},{repeat},{angle:.2f},0.2"


def test_tables_and_picture_are_written_where_home_is_not(tmp_path):
    rng = np.random.default_rng(0)
    rows = [*rows_of("glass", 0.25, rng), *rows_of("$5_$6_ plate", 0.45, rng)]
    table = write(tmp_path, *(row.replace(",90,", ",$w_$x_,") for row in rows))
    out, details, picture = (tmp_path / name for name in ("mu.csv", "mu.json", "mu.svg"))
    words = [str(table), "--out", str(out), "--json", str(details), "--picture", str(picture)]
    command = [sys.executable, "-m", "slipstitch", "capture", "reference", *words]
    home = os.environ | {"HOME": "/proc/nowhere", "XDG_CONFIG_HOME": "", "XDG_CACHE_HOME": ""}
    done = subprocess.run(command, capture_output=True, text=True, env=home)
    assert (done.returncode, done.stderr) == (0, "")
    said = done.stdout.splitlines()
    assert said[0].startswith("denim on glass: 0.2")
    assert "; 3 positions " in said[0]
    rows = list(csv.DictReader(out.open()))
    assert [row["substrate"] for row in rows] == ["glass", "$5_$6_ plate"]
    assert float(rows[1]["mu"]) == pytest.approx(0.45, abs=0.02)
    assert json.loads(details.read_text())[0]["by_position"]["A"][1] == 4
    drawn = picture.read_text()
    assert drawn.startswith("<?xml")
    assert "on $5_$6_ plate -->" in drawn and "<!-- orientation $w_$x_ -->" in drawn


ROW = "denim,glass,A,0,1,14.2,0.2"


@pytest.mark.parametrize(
    ("rows", "problem"),
    [
        ([ROW, ROW], "line 3: duplicates line 2"),
        ([ROW.replace("14.2", "-3")], "angle_deg: '-3'; must be a number above 0 and below 85"),
        ([ROW, ROW.replace(",1,", ",2,").replace("0.2", "0.3")], "differs in bench_error_deg from"),
        ([ROW], "denim on glass: 1 slip angle(s); at least 3 are required"),
        ([ROW.replace("A,0,", f"A,{k},") for k in range(4)], "4 slip angle(s); at least 5"),
        ([ROW.replace(",1,", f",{k},") for k in range(4)], "all slip angles are equal"),
    ],
)
def test_a_wrong_table_is_one_line(tmp_path, capsys, rows, problem):
    table = write(tmp_path, *rows)
    assert problem in refused(capsys, f"capture reference {table} --out {tmp_path}/mu.csv")
    assert not (tmp_path / "mu.csv").exists()
