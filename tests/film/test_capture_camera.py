"""``slipstitch capture camera``: known cameras recovered from photographs of a board."""

import json
import shutil
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from support import board_photographs as bench
from support.analytic_stage import write_avi
from support.refusal import refused, run

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import read_sidecar
from slipstitch.film.board import Board, BoardView, Sighting, read_views
from slipstitch.film.camera_calibration import FloorPlace, draw_residuals
from slipstitch.images.calibrated_view import cloth_room, crop_to
from slipstitch.images.camera_file import read_camera_file
from slipstitch.images.rectification import rectify, stage_plane

VIEWS = 9
BLACK = np.zeros((*bench.SIZE[::-1], 3), np.uint8)
CHECKERBOARD = "--squares 10x7 --square-mm 25"


def photograph(folder, charuco=False):
    """Photographs of the board in the hand, and one of it on the floor."""
    board = bench.own_image(charuco)
    for k, place in enumerate(bench.board_places(VIEWS)):
        cv2.imwrite(str(folder / f"view{k}.png"), bench.photograph(board, *place))
    cv2.imwrite(str(folder / "floor.png"), bench.photograph(board, *bench.floor_place()))


def command_of(folder, words="", out="camera.json"):
    views = " ".join(map(str, sorted(folder.glob("view*.png"))))
    place = f"--angle-deg {bench.ANGLE_DEG} --thickness-mm {bench.THICKNESS_MM} --place-mm"
    x_mm, y_mm = bench.PLACE_MM
    stage = f"--stage-view {folder}/floor.png {place} {x_mm} {y_mm}"
    return f"capture camera {views} {stage} {CHECKERBOARD} {words} --out {folder}/{out}"


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    folder = tmp_path_factory.mktemp("camera")
    photograph(folder)
    assert run(command_of(folder, f"--picture {folder}/camera.png")) == 0
    return folder


def check_recovered(path):
    """The lens to within its own uncertainty, the camera's place to a few millimetres."""
    content, lens = json.loads(path.read_text()), read_camera_file(path)
    found = np.array(content["focal_px"] + content["principal_point_px"])
    spread = content["uncertainty"]
    of_lens = np.array(spread["focal_px"] + spread["principal_point_px"])
    truth = bench.MATRIX[[0, 1, 0, 1], [0, 1, 2, 2]]
    assert (np.abs(found - truth) < 4 * of_lens).all(), (found, truth, spread)
    assert (of_lens < 0.005 * bench.MATRIX[0, 0]).all()
    # Over the middle of the image, where the board was, both lenses do the same.
    rays = np.stack(np.meshgrid(np.linspace(-0.3, 0.3, 7), np.linspace(-0.2, 0.2, 5)), axis=-1)
    rays = np.append(rays.reshape(-1, 2), np.ones((35, 1)), axis=1)
    still = (np.zeros(3), np.zeros(3))
    true = cv2.projectPoints(rays, *still, bench.MATRIX, bench.DISTORTION)[0]
    ours = cv2.projectPoints(rays, *still, lens.matrix, lens.distortion)[0]
    assert np.abs(true - ours - (true - ours).mean(axis=0)).max() < 0.7
    away = -lens.rotation.T @ lens.translation_m - bench.POSITION_M
    assert np.linalg.norm(away) < 4 * spread["position_m"] + 1e-3
    turn, translation_m = bench.camera_pose()
    off = np.degrees(np.linalg.norm(cv2.Rodrigues(lens.rotation @ turn.T)[0]))
    assert off < 0.6

    def truly_seen(points_m):
        turned = cv2.Rodrigues(turn)[0], translation_m
        return cv2.projectPoints(points_m, *turned, bench.MATRIX, bench.DISTORTION)[0][:, 0]

    # What counts: where points of the stage appear.
    points = np.random.default_rng(0).uniform((-0.05, -0.1, 0), (0.35, 0.1, 0.2), (40, 3))
    assert np.abs(lens.project(points) - truly_seen(points)).max() < 0.6
    # Where the camera sees an edge across the track, it tells the height as well as it says.
    edge = np.array([[0.0, 0, 0.15], [0, 0.01, 0.15], [0, 0, 0.151]])
    here, aside, up = lens.project(edge)
    normal = np.array([here[1] - aside[1], aside[0] - here[0]])
    off_m = 0.001 * (normal @ (truly_seen(edge)[0] - here)) / (normal @ (up - here))
    assert abs(off_m) < 3 * spread["clamp_height_m"]
    assert 0.0002 < spread["clamp_height_m"] < 0.001


def test_a_known_camera_is_recovered_from_photographs_of_a_checkerboard(work):
    check_recovered(work / "camera.json")
    content = json.loads((work / "camera.json").read_text())
    assert 0.02 < content["reprojection_error_px"]["rms"] < 0.25
    assert len(content["reprojection_error_px"]["views"]) == VIEWS
    assert content["image_size_px"] == list(bench.SIZE)
    record = read_sidecar(work / "camera.json")
    assert record["stage"] == read_sidecar(work / "camera.png")["stage"] == "capture"
    assert len(record["inputs"]) == VIEWS + 1
    assert cv2.imread(str(work / "camera.png")).shape[1] > 800


def test_a_known_camera_is_recovered_from_photographs_of_a_charuco_board(tmp_path):
    photograph(tmp_path, charuco=True)
    board = f"--board charuco --marker-mm 19 --dictionary {bench.DICTIONARY}"
    assert run(command_of(tmp_path, board)) == 0
    check_recovered(tmp_path / "camera.json")


def test_names_of_views_with_dollars_are_drawn_as_they_are(tmp_path):
    corners = np.array([[1.0, 2.0], [3.0, 4.0]])
    view = BoardView("views/$5_$6_.png", (8, 6), Sighting(np.zeros((2, 3)), corners))
    result = SimpleNamespace(views=[view], residuals_px=[corners / 10], size_px=(8, 6), rms_px=0.1)
    draw_residuals(result, tmp_path / "a.svg", "svg")
    assert "<!-- $5_$6_.png -->" in (tmp_path / "a.svg").read_text()


def test_a_crop_of_a_real_image_shows_what_the_renderer_draws(work):
    # The floor's board, cut from the photograph as the crop of the calibrated view is cut.
    lens = read_camera_file(work / "camera.json")
    crop = crop_to(lens.pose, cloth_room(0.1, 0.15, 0.2, 0.2), 256)
    image = cv2.imread(str(work / "floor.png"))
    cut, _ = rectify(image, lens, crop, stage_plane(crop, 0.1))
    seen = Board((10, 7), 0.025).find(cv2.cvtColor(cut, cv2.COLOR_BGR2GRAY))
    on_stage = FloorPlace(*bench.PLACE_MM, bench.ANGLE_DEG, bench.THICKNESS_MM)
    expected = crop.project(on_stage.on_stage(seen.points_m.astype(float)))
    assert np.abs(seen.corners_px - expected).max() < 0.8


def test_a_video_of_the_board_will_do(work, tmp_path, capsys):
    images = [cv2.imread(str(work / f"view{k // 2}.png")) for k in range(2 * VIEWS)]
    path = write_avi(tmp_path / "board.avi", [*images, BLACK])  # the board is not in every frame
    out = tmp_path / "camera.json"
    assert run(f"capture camera {path} {CHECKERBOARD} --out {out}") == 0
    assert "18 views" in capsys.readouterr().out
    content = json.loads(out.read_text())
    assert content["focal_px"] == pytest.approx([612, 631], rel=0.01)
    # It lacks the position of the camera, so that nothing can be rendered from it.
    with pytest.raises(BadInput, match="does not contain the position of the camera"):
        read_camera_file(out)


@pytest.mark.parametrize("quarter_turns", range(4))
@pytest.mark.parametrize("charuco", [False, True])
def test_a_board_is_found_the_right_way_round(quarter_turns, charuco):
    image = np.pad(bench.own_image(charuco), 60, constant_values=150)
    image = cv2.GaussianBlur(image, (5, 5), 1)
    board = Board(bench.SQUARES, 0.02, *((0.0152, bench.DICTIONARY) if charuco else ()))
    seen = board.find(np.ascontiguousarray(np.rot90(image, quarter_turns)))
    height, width = image.shape
    # Corner (1, 1) of the drawing, two squares and the frame from its edges, turned likewise.
    x = y = 60 + 2 * bench.TEXELS - 0.5
    for _ in range(quarter_turns):
        x, y, width, height = y, width - 1 - x, height, width
    first = np.flatnonzero(np.isclose(seen.points_m[:, :2], 0.02).all(axis=1))
    np.testing.assert_allclose(seen.corners_px[first], [[x, y]], atol=0.2)


@pytest.fixture
def copy(work, tmp_path):
    """The photographs of the bench, to be damaged."""
    for path in work.glob("*.png"):
        shutil.copy(path, tmp_path)
    return tmp_path


def test_a_mistaken_view_is_left_out_and_named(work, copy):
    bent = cv2.imread(str(work / "view3.png"))
    y, x = np.mgrid[: bent.shape[0], : bent.shape[1]].astype(np.float32)
    bent = cv2.remap(bent, x + 6 * np.sin(x / 50), y, cv2.INTER_LINEAR)
    cv2.imwrite(str(copy / "view3.png"), bent)
    assert run(command_of(copy)) == 0
    content = json.loads((copy / "camera.json").read_text())
    assert [Path(name).name for name in content["views_left_out"]] == ["view3.png"]
    check_recovered(copy / "camera.json")


def black(name):
    """Blackens photographs of the bench."""
    return lambda folder: [cv2.imwrite(str(path), BLACK) for path in folder.glob(name)]


def too_few(folder):
    for k in range(4, VIEWS):
        (folder / f"view{k}.png").unlink()


def alike(folder):
    # The board flat in front of the camera, moved sideways only.
    image = np.pad(bench.own_image()[::3, ::3], ((40, 80), (60, 180)), constant_values=180)
    image = cv2.GaussianBlur(image, (5, 5), 1)
    for k in range(VIEWS):
        moved = np.roll(image, (4 * k, 9 * k), axis=(0, 1))
        cv2.imwrite(str(folder / f"view{k}.png"), cv2.resize(moved, bench.SIZE))


def larger(folder):
    path = str(folder / "view1.png")
    cv2.imwrite(path, cv2.resize(cv2.imread(path), (600, 450)))


def no_image(folder):
    (folder / "view2.png").write_text("no image")


def fine(folder):
    pass


@pytest.mark.parametrize(
    ("damage", "words", "message"),
    [
        (black("view*.png"), "", "no checkerboard of 10x7 squares in any of 9 image(s)"),
        (no_image, "", "view2.png: not an image"),
        (too_few, "", "the board was found in only 4 usable view(s); at least 5 are required"),
        (alike, "", "views are too similar"),
        (larger, "", "all images of a camera must have the same size"),
        (black("floor.png"), "", "floor.png: no board found in it"),
        (fine, "--squares 9x7", "one odd and one even number"),
        (fine, "--squares board", "must be width x height, at least 4x4"),
        (fine, f"--squares {'9' * 5000}x10", "at most 100x100"),
        (fine, "--square-mm inf", "--square-mm: inf; must be greater than 0.1 and at most"),
        (fine, "--place-mm nan 0", "--place-mm: nan; must be from -10000 to 10000"),
        (fine, "--angle-deg nan", "--angle-deg: nan; must be from -360 to 360"),
        (fine, "--board charuco", "required for a ChArUco board, smaller than its squares"),
        (fine, "--stage-view none.png", "none.png: no such file"),
    ],
)
def test_bad_input_is_one_clear_line(copy, capsys, damage, words, message):
    damage(copy)
    assert message in refused(capsys, command_of(copy, words, out="bad.json"))
    assert not (copy / "bad.json").exists()


@pytest.mark.parametrize(("frames", "looked_at"), [(60, 60), (61, 31), (119, 60), (121, 41)])
def test_of_a_video_sixty_frames_at_most_are_looked_at(tmp_path, frames, looked_at):
    path = write_avi(tmp_path / "empty.avi", [BLACK[:48, :64]] * frames)
    with pytest.raises(BadInput, match=rf"in any of {looked_at} frame"):
        read_views([path], Board((10, 7), 0.02))


AT_THE_TRACK = {"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "translation_m": [-0.15, 0, -0.07]}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": "other"}, "not a camera file"),
        ({"focal_px": [600, -1]}, "not positive"),
        ({"focal_px": [600]}, "focal_px must contain 2 finite numbers"),
        ({"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}, "not a rotation matrix"),
        ({"distortion": {"k1": 0.1}}, "distortion must contain k1, k2, p1, p2, k3"),
        ({"translation_m": None}, "does not contain the position of the camera"),
        (AT_THE_TRACK, "the camera would stand 0 m from the middle of .*; must be 0.2 to 5 m"),
        ({"translation_m": [1e200, 1, 1]}, "the camera would stand 1e.200 m from"),
        ({"translation_m": [1.7e308, 1.7e308, -1.7e308]}, "translation_m: the camera would"),
    ],
)
def test_a_damaged_camera_file_is_bad_input(work, tmp_path, change, message):
    content = json.loads((work / "camera.json").read_text()) | change
    (tmp_path / "camera.json").write_text(json.dumps(content))
    with pytest.raises(BadInput, match=message):
        read_camera_file(tmp_path / "camera.json")
