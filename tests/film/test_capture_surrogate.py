"""Surrogate captures: made unlike the training data, and always called what they are."""

import numpy as np
import pytest
from support.refusal import refused, run

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import read_sidecar
from slipstitch.config import resolve_config, write_config
from slipstitch.dataset.videos import read_videos
from slipstitch.design.stage_path import StagePath
from slipstitch.film.captures_table import read_captures
from slipstitch.film.frame_schedule import Schedule
from slipstitch.film.ingest_videos import read_known
from slipstitch.film.slip_angles import estimate, read_angles
from slipstitch.film.stage_clock import StageFollower
from slipstitch.film.surrogates import (
    FRAME_RATE_HZ,
    calibrated_camera,
    film_size,
    filmed,
    films,
    surrogate_simulation,
    true_camera,
    write_bench,
)
from slipstitch.images.calibrated_view import cloth_room
from slipstitch.images.camera_file import read_camera_file

CONFIG = resolve_config({"simulation": {"frames": 92}})


def test_friction_lies_off_the_grid_and_differs_from_film_to_film():
    made = films(CONFIG)
    assert len(made) == 4 * 5
    friction = np.array([film.friction for film in made])
    assert len(set(friction)) == len({film.seed for film in made}) == 20
    assert np.abs(friction[:, None] - np.array(CONFIG.grid.frictions)).min() > 1e-3
    spread = np.std(np.log(friction.reshape(4, 5)), axis=1)
    assert 0.005 < spread.mean() < 0.06
    assert made == films(CONFIG)


def test_films_are_simulated_more_finely_over_the_same_time():
    own, training = surrogate_simulation(CONFIG), CONFIG.simulation
    assert own.vertices_per_side > training.vertices_per_side
    assert own.time_step_s < training.time_step_s
    assert own.yaw_sd_deg > training.yaw_sd_deg
    end_s = (training.frames - 1) / training.frame_rate_hz
    assert (own.frames - 1) / own.frame_rate_hz >= end_s
    # As in config/paper.yaml: repeats differ though the training perturbs nothing.
    still = {"yaw_sd_deg": 0.0, "height_sd_m": 0.0, "fabric_sd_rel": 0.0, "curl_side": "same"}
    simulation = training.model_copy(update=still)
    assert own == surrogate_simulation(CONFIG.model_copy(update={"simulation": simulation}))


def test_the_camera_file_is_as_wrong_as_a_calibration_and_the_slip_angles_right(tmp_path):
    write_bench(CONFIG, tmp_path)
    read = read_camera_file(tmp_path / "camera.json")
    found, true = calibrated_camera(CONFIG), true_camera(CONFIG)
    assert np.allclose(read.matrix, found.matrix)
    path = StagePath(**dict(CONFIG.simulation.stage))
    room = cloth_room(*path.position_m(np.linspace(0, path.duration_s, 200)), 0.2, 0.2)
    off_px = np.linalg.norm(found.project(room) - true.project(room), axis=1)
    assert 0.05 < off_px.max() < 3
    # The whole travel is in the image.
    assert (true.project(room) > 0).all()
    assert (true.project(room) < np.array(film_size(CONFIG.captures)) - 1).all()
    # The inclined plane measures the pairs' friction.
    measured = read_angles(tmp_path / "slip_angles.csv")
    for pair, reference in zip(CONFIG.captures.pairs, map(estimate, measured), strict=True):
        assert abs(reference.mu - pair.friction) < 2 * reference.error
        assert reference.error < 0.15 * pair.friction


def test_the_table_calls_every_film_a_surrogate(tmp_path):
    write_bench(CONFIG, tmp_path)
    for k, film in enumerate(films(CONFIG)):
        (tmp_path / f"{film.id}.mp4").write_bytes(bytes([k]))
    pairs = [f"{one.material},{one.substrate},0.4,0.02\n" for one in CONFIG.captures.pairs]
    reference = "".join(["material,substrate,mu,error\n", *pairs])
    (tmp_path / "reference.csv").write_text(reference)
    captures = read_captures(tmp_path / "captures.csv", tmp_path / "reference.csv")
    assert [one.id for one in captures] == [film.id for film in films(CONFIG)]
    assert all(one.surrogate for one in captures)
    substrates = {one.substrate: one.reflective for one in captures}
    dull = dict.fromkeys(("matte", "ceramic", "smooth-glass"), False)
    assert substrates == dull | {"aluminium": True}
    mixed = (tmp_path / "captures.csv").read_text().replace("yes", "no", 1)  # the first is matte
    (tmp_path / "mixed.csv").write_text(mixed)
    with pytest.raises(BadInput, match="must not mix surrogate and real captures"):
        read_captures(tmp_path / "mixed.csv", tmp_path / "reference.csv")


def test_impossible_pairs_and_unknown_films_are_refused(tmp_path, capsys):
    pair = {"material": "gray-interlock", "substrate": "matte", "friction": 0.3}
    for pairs, problem in (
        ([pair | {"material": "silk"}], "unknown material"),
        ([pair | {"substrate": "ice"}], "unknown floor 'ice'"),
        ([pair, pair], "duplicate fabric on the same substrate"),
    ):
        with pytest.raises(BadInput, match=problem):
            resolve_config({"captures": {"pairs": pairs}})
    write_config(CONFIG, tmp_path / "config.json")
    command = f"capture surrogate --config {tmp_path}/config.json --film c09_r01 --out x.mp4"
    assert "unknown surrogate capture 'c09_r01'" in refused(capsys, command)


def test_a_film_shows_all_that_its_clock_is_read_from_however_few_its_later_frames():
    path = StagePath()
    time_s = np.arange(1400) / FRAME_RATE_HZ
    seen_s = time_s[filmed(time_s, path, 25)]
    assert (seen_s <= 3).sum() == 37
    later_s = seen_s[seen_s > 8]
    assert np.allclose(np.diff(later_s), 25 / FRAME_RATE_HZ)
    follower = StageFollower(true_camera(CONFIG), Schedule.of(CONFIG))
    chosen = follower.choose(seen_s, np.ones(len(seen_s), bool))
    # Three frames at rest, then nearly all of the drag's.
    assert len(chosen) >= 3 + 0.9 * len(later_s[later_s < path.duration_s])


@pytest.mark.slow
def test_a_tiny_film_goes_through_the_same_files_as_a_real_one(tmp_path, capsys, monkeypatch):
    """Simulated, rendered, distorted, compressed; then found, rectified and cropped."""
    tiny = {"repeats": 1, "vertices_per_side": 9, "time_step_s": 0.084, "width_px": 128}
    pair = {"material": "royal-target", "substrate": "matte", "friction": 0.45}
    config = resolve_config(
        {
            "simulation": {"frames": 9, "self_contact": False},
            "sample": {"frames": 3},
            "render": {"pixels": 32},
            "captures": {"pairs": [pair], **tiny},
        }
    )
    write_config(config, tmp_path / "config.json")
    monkeypatch.chdir(tmp_path)
    for command in (
        "surrogate --config config.json --bench .",
        "surrogate --config config.json --film c00_r01 --out c00_r01.mp4",
        "reference slip_angles.csv --out reference.csv",
        "ingest captures.csv --reference reference.csv --config config.json --out-dir set",
    ):
        assert run(f"capture {command}") == 0
    film = tmp_path / "c00_r01.mp4"
    assert read_sidecar(film)["surrogate"] is True
    assert b"surrogate capture" in film.read_bytes()
    (known,) = read_known(tmp_path / "set")
    assert known["surrogate"] and known["start_found"]
    assert known["start_s"] == pytest.approx(40 / 12, abs=0.04)
    videos = read_videos(tmp_path / "set")
    assert videos.pixels.shape == (1, 3, 32, 32, 3)
    assert videos.pixels.std() > 20
    assert "1 videos of 1 pairs" in capsys.readouterr().out
