"""Cameras calibrated elsewhere, and boards of other kinds."""

import json

import cv2
import numpy as np
import pytest
from support.board_photographs import board_image, photograph
from support.refusal import refused, run

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance.files import read_json
from slipstitch.film.board import Board, read_views
from slipstitch.film.measure import EXAMPLE_CAMERA
from slipstitch.images.camera_file import read_camera_file, read_foreign_lens

SIZES = [(640, 480), (1920, 1080), (1080, 1920)]
DISTORTION = [-0.21, 0.08, 0.001, -0.0007, 0.01]


def lens_of(size):
    return np.array(
        [[0.93 * max(size), 0, size[0] / 2 - 7], [0, 0.935 * max(size), size[1] / 2 + 5], [0, 0, 1]]
    )


def opencv(suffix):
    def write(path, size, matrix):
        storage = cv2.FileStorage(str(path.with_suffix(suffix)), cv2.FILE_STORAGE_WRITE)
        storage.write("image_width", size[0])
        storage.write("image_height", size[1])
        storage.write("camera_matrix", matrix)
        storage.write("distortion_coefficients", np.array([DISTORTION]))
        storage.release()
        return path.with_suffix(suffix)

    return write


def ros_file(path, size, matrix):
    path.write_text(
        f"image_width: {size[0]}\nimage_height: {size[1]}\ncamera_name: bench\n"
        f"camera_matrix:\n  rows: 3\n  cols: 3\n  data: {matrix.ravel().tolist()}\n"
        f"distortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n"
        f"  data: {DISTORTION}\nrectification_matrix:\n  rows: 3\n  cols: 3\n"
        "  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]\n"
    )
    return path


def ros_message(path, size, matrix):
    path.write_text(
        f"header:\n  seq: 1\nheight: {size[1]}\nwidth: {size[0]}\ndistortion_model: plumb_bob\n"
        f"D: {DISTORTION}\nK: {matrix.ravel().tolist()}\nR: [1, 0, 0, 0, 1, 0, 0, 0, 1]\n---\n"
    )
    return path


def plain(path, size, matrix):
    content = {"rms": 0.2, "mtx": matrix.tolist(), "dist": [DISTORTION], "image_size": size}
    path.write_text("\ufeff" + json.dumps(content), encoding="utf-8")
    return path


FORMATS = [opencv(".yml"), opencv(".xml"), opencv(".json"), ros_file, ros_message, plain]


@pytest.mark.parametrize(
    ("write", "size"), [*((one, SIZES[0]) for one in FORMATS), *((plain, one) for one in SIZES[1:])]
)
def test_a_lens_is_read_whoever_wrote_it(tmp_path, size, write):
    path = write(tmp_path / "camera.yaml", size, lens_of(size))
    lens = read_foreign_lens(path)
    assert lens.size_px == size
    np.testing.assert_allclose(lens.matrix, lens_of(size))
    np.testing.assert_allclose(lens.distortion, DISTORTION)
    with pytest.raises(BadInput, match=r"of another program.*capture camera --from"):
        read_camera_file(path)
    out = tmp_path / "out.json"
    assert run(f"capture camera --from {path} --out {out}") == 0
    assert json.loads(out.read_text())["principal_point_px"] == lens_of(size)[:2, 2].tolist()
    with pytest.raises(BadInput, match="does not contain the position of the camera"):
        read_camera_file(out)


def test_a_byte_order_mark_does_no_harm(tmp_path):
    text = EXAMPLE_CAMERA.read_text()
    (tmp_path / "marked.json").write_text(text, encoding="utf-8-sig")
    np.testing.assert_array_equal(
        read_camera_file(tmp_path / "marked.json").matrix, read_camera_file(EXAMPLE_CAMERA).matrix
    )
    assert read_json(tmp_path / "marked.json") == json.loads(text)


GOOD = {"camera_matrix": lens_of((640, 480)).tolist(), "dist": DISTORTION, "width": 640}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"width": None}, "no image_width and image_height"),
        ({"dist": [*DISTORTION, 0.1, 0, 0]}, "8 distortion_coefficients; only k1, k2, p1, p2"),
        ({"dist": [0.1]}, "1 distortion_coefficients; must be 4 or 5"),
        ({"distortion_model": "equidistant"}, "a fisheye lens"),
        ({"camera_matrix": [[600, 3, 320], [0, 600, 240], [0, 0, 1]]}, "a skew of 3"),
        ({"camera_matrix": "none"}, "camera_matrix must contain numbers"),
        ({"camera_matrix": None}, "no camera_matrix; needed are"),
        ({"width": 480, "height": 640}, "width and height, are swapped"),
    ],
)
def test_a_lens_that_cannot_be_expressed_is_one_line(tmp_path, change, message):
    (tmp_path / "a.json").write_text(json.dumps(GOOD | {"height": 480} | change))
    with pytest.raises(BadInput, match=message):
        read_foreign_lens(tmp_path / "a.json")


def test_a_principal_point_whose_coordinates_are_swapped_is_named(tmp_path):
    for size in SIZES:
        swapped = {"image_size_px": size, "principal_point_px": [size[1] / 2 + 4, size[0] / 2]}
        content = json.loads(EXAMPLE_CAMERA.read_text()) | swapped
        (tmp_path / "camera.json").write_text(json.dumps(content))
        with pytest.raises(BadInput, match="x and y, or width and height, are swapped"):
            read_camera_file(tmp_path / "camera.json")


# Boards

IMAGE = (960, 720)
MATRIX = np.array([[900.0, 0, 480], [0, 905.0, 360], [0, 0, 1]])


def photographs(folder, squares, count=8, distance=1.0, **kind):
    """Files of a board of 2 cm squares in the hand, the first as on a floor below the camera."""
    rng, board = np.random.default_rng(1), board_image(squares, **kind)
    middle = np.array([*squares, 0]) * 0.02 / 2
    for number in range(count):
        turn, _ = cv2.Rodrigues(rng.uniform(-0.5, 0.5, 3) * (number > 0))
        away_m = distance * max(squares) * 0.02 * 900 / 700
        at = np.array([*rng.uniform(-0.01, 0.01, 2), away_m]) - turn @ middle
        image = photograph(board, turn, at, MATRIX, np.zeros(5), IMAGE, 0.02)
        cv2.imwrite(str(folder / f"{number}.png"), image)
    return sorted(folder.glob("*.png"))


@pytest.mark.parametrize(
    ("squares", "is_legacy"), [((9, 6), False), ((9, 6), True), ((6, 8), True), ((8, 5), False)]
)
def test_a_charuco_board_of_either_pattern_is_found(tmp_path, squares, is_legacy):
    paths = photographs(tmp_path, squares, is_legacy=is_legacy)
    board = f"--board charuco --squares {squares[0]}x{squares[1]} --square-mm 20 --marker-mm 15"
    out = tmp_path / "camera.json"
    assert run(f"capture camera {' '.join(map(str, paths))} {board} --out {out}") == 0
    assert json.loads(out.read_text())["focal_px"] == pytest.approx([900, 905], rel=0.01)


CHARUCO = {"marker_m": 0.015, "dictionary": "DICT_5X5_100"}
FINER = {"dictionary": "DICT_6X6_250"}


@pytest.mark.parametrize(
    ("kind", "asked", "message"),
    [
        ({}, {"squares": (6, 9), **CHARUCO}, "width and height are swapped"),
        ({}, {"squares": (7, 5), **CHARUCO}, "a board of 27 markers; 7x5 squares have 17"),
        ({}, {"squares": (12, 9), **CHARUCO}, "a board of 27 markers; 12x9 squares have 54"),
        (FINER, {"squares": (9, 6), **CHARUCO}, "27 markers of DICT_6X6_50.*--dictionary DICT_6X6"),
        ({"dictionary": None}, {"squares": (9, 6), **CHARUCO}, "9x6 squares is seen, without mark"),
        ({}, {"squares": (9, 6)}, "27 markers of DICT_5X5_50.*--board charuco"),
        ({"dictionary": None}, {"squares": (8, 5)}, "9x6 squares is seen, which has 8x5 inner cor"),
        ({"dictionary": None}, {"squares": (6, 11)}, "a checkerboard of 9x6 squares is seen"),
    ],
)
def test_where_a_board_is_not_found_it_is_said_what_is(tmp_path, kind, asked, message):
    paths = photographs(tmp_path, (9, 6), count=3, **kind)
    with pytest.raises(BadInput, match=message):
        read_views(paths, Board(square_m=0.02, **asked))


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("square_mm", [2.0, 200.0])
def test_a_square_in_another_unit_is_refused_where_the_camera_is_placed(
    tmp_path, square_mm, capsys
):
    paths = photographs(tmp_path, (9, 6), dictionary=None, distance=2.5)
    command = f"capture camera {' '.join(map(str, paths))} --squares 9x6 --stage-view {paths[0]}"
    command += f" --place-mm 60 60 --out {tmp_path}/a.json --square-mm"
    assert run(f"{command} 20") == 0
    # How thick the board is was not said: the camera tells no heights.
    assert json.loads((tmp_path / "a.json").read_text())["uncertainty"]["clamp_height_m"] is None
    said = refused(capsys, f"{command} {square_mm:g}")
    assert f"are the squares {square_mm:g} mm (--square-mm)?" in said
