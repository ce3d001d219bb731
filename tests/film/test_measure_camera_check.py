"""``slipstitch capture check`` and ``measure``: cameras outside the poses of the training."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from support import analytic_stage as stage
from support.models import untrained_instrument
from support.refusal import refused, run

from slipstitch.base.provenance import read_sidecar
from slipstitch.config import write_config
from slipstitch.config.catalogue import Viewpoint
from slipstitch.film.measure.camera_check import check_camera, check_figure
from slipstitch.film.measure.measuring_bench import measuring_bench
from slipstitch.images.camera import pose
from slipstitch.learning.instrument.measuring import save_instrument
from slipstitch.learning.instrument.poses import outside, pose_range, poses_of

CONFIG, _ = stage.protocol()
FAMILY = {
    "yaw_deg": [-15.0, 15.0],
    "pitch_deg": [-8.0, 8.0],
    "roll_deg": [-2.0, 2.0],
    "log_distance": [-0.2, 0.2],
}


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    folder = tmp_path_factory.mktemp("check")
    write_config(CONFIG, folder / "config.json")
    instrument = untrained_instrument(64, knows_pose=True)
    instrument.card["pose_range"] = FAMILY
    save_instrument(instrument, folder / "instrument")
    place = pose(Viewpoint(40.0, 24.0, 1.4))
    turn, _ = cv2.Rodrigues(np.array([0.0, np.pi, 0.0]))
    for name, lens in {
        "inside": stage.lens_camera(*pose(Viewpoint(52.0, 20.0, 1.5))),
        "edge": stage.lens_camera(*pose(Viewpoint(57.0, 24.0, 1.4))),
        "aside": stage.lens_camera(*pose(Viewpoint(65.0, 24.0, 1.4))),
        "far": stage.lens_camera(*pose(Viewpoint(40.0, 24.0, 2.4))),
        "panned_away": stage.lens_camera(*(turn @ part for part in place)),
        "long_focus": stage.lens_camera(*place, focal_px=5000.0),
        "focal_mm": stage.lens_camera(*place, focal_px=35.0),
    }.items():
        stage.camera_file(lens, folder / f"{name}.json")
    return folder


def measure(bench, name, words=""):
    """The command that measures with such a camera a film that is not there."""
    files = f"{bench}/no.mp4 --camera {bench}/{name}.json --model {bench}/instrument"
    return f"measure {files} {words}"


def check(bench, name, words=""):
    return run(f"capture check {bench}/{name}.json --model {bench}/instrument {words}")


def test_a_camera_inside_the_family_is_told_so_and_drawn_with_its_record(bench, capsys):
    picture = bench / "new" / "check.png"
    assert check(bench, "inside", f"--picture {picture}") == 0
    said = capsys.readouterr().out
    assert "rotation about the vertical +12 degrees (trained on -15 ... +15)" in said
    assert "sees 100 % of the crop, at the worst time of the protocol" in said
    assert "OUTSIDE" not in said
    assert picture.stat().st_size > 10_000
    names = {Path(name).name for name in read_sidecar(picture)["inputs"]}
    assert names == {"inside.json", "config.json", "instrument.json"}


def test_a_camera_beyond_the_family_within_the_tolerance_is_told_how_far(bench, capsys):
    assert check(bench, "edge") == 0
    said = capsys.readouterr().out.splitlines()[-1]
    assert said == (
        "just beyond the training range, within the tolerance: rotation about the vertical "
        "+17 degrees (trained on -15 ... +15)"
    )
    # A measurement with this camera says the same.
    edge = measuring_bench(bench / "edge.json", bench / "instrument")
    assert edge.caveats == (said,) and edge.outside == ()
    assert measuring_bench(bench / "inside.json", bench / "instrument").caveats == ()
    # One by force knows where its camera is outside.
    aside = measuring_bench(bench / "aside.json", bench / "instrument", force=True)
    assert aside.outside == ("rotation about the vertical +25 degrees (trained on -15 ... +15)",)
    assert aside.caveats == ()  # the alarm says it


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("aside", "rotation about the vertical +25 degrees (trained on -15 ... +15)"),
        ("far", "distance 1.71 times that of the calibrated viewpoint (trained on 0.82 ... 1.22)"),
    ],
)
def test_a_camera_outside_is_named_and_not_measured_with(bench, capsys, name, problem):
    assert check(bench, name) == 3
    assert problem in capsys.readouterr().out
    said = refused(capsys, measure(bench, name))
    assert problem in said and "--force measures anyway" in said
    assert "no.mp4: no such file" in refused(capsys, measure(bench, name, "--force"))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("panned_away", "the camera sees only 0 % of the crop; at least 80 % needed"),
        ("long_focus", "the camera sees only 6 % of the crop; at least 80 % needed"),
        # As with a focal length in millimetres: everything is in view, in a few pixels.
        ("focal_mm", "pixels for each of the instrument's; at least 0.8 needed"),
    ],
)
def test_a_camera_that_does_not_see_the_track_is_told_so_before_any_film_is_read(
    bench, capsys, name, problem
):
    assert check(bench, name) == 3
    told = capsys.readouterr().out
    assert "OUTSIDE" in told and problem in told
    said = refused(capsys, measure(bench, name, "--force"))
    assert problem in said and "no.mp4" not in said


def test_the_picture_shows_the_range_the_tolerance_and_the_roll(bench):
    figure = check_figure(check_camera(bench / "edge.json", bench / "instrument"))
    above, aside, roll = figure.axes
    for view in (above, aside):
        trained, admitted = (
            next(line for line in view.lines if line.get_label().startswith(name))
            for name in ("training range", "tolerance")
        )
        assert admitted.get_linestyle() == "--"
        assert np.ptp(admitted.get_xdata()) > np.ptp(trained.get_xdata())
    assert [float(line.get_xdata()[0]) for line in roll.lines] == pytest.approx(
        [-4, 4, 0], abs=1e-6
    )
    assert "just beyond the training range" in figure.get_suptitle()


def test_the_range_is_that_of_the_videos():
    rows = [{"pose_yaw_deg": -3.0, "pose_log_distance": 0.1}, {"pose_yaw_deg": 4.0}]
    tested = pose_range(poses_of(rows))
    assert tested["yaw_deg"] == [-3.0, 4.0] and tested["roll_deg"] == [0.0, 0.0]
    near = {"yaw_deg": 5.0, "pitch_deg": 0.0, "roll_deg": 0.0, "log_distance": 0.0}
    assert outside(near, tested) == []
    assert len(outside(near | {"yaw_deg": 9.0, "roll_deg": -9.0}, tested)) == 2


def test_the_pose_reaches_the_network():
    instrument = untrained_instrument(knows_pose=True)
    frames = np.random.default_rng(0).integers(0, 255, (6, 32, 32, 3), dtype=np.uint8)
    answers = {
        yaw: instrument.measure(frames, pose=np.array([yaw, 0, 0, 0])).distribution[1]
        for yaw in (0.0, 15.0)
    }
    assert np.abs(answers[0.0] - answers[15.0]).max() > 1e-6
    assert (answers[0.0] == instrument.measure(frames).distribution[1]).all()
