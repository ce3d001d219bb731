"""The clock of a film, told by the stage's motion over the whole film, and its start."""

import functools
import os
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support import analytic_stage as stage

from slipstitch.base.errors import BadInput
from slipstitch.config.catalogue import VIEWPOINTS
from slipstitch.film import stage_start
from slipstitch.film.frame_schedule import Schedule
from slipstitch.film.ingest_videos import ingest
from slipstitch.film.stage_clock import StageFollower, TimeBase
from slipstitch.film.stage_start import find_start
from slipstitch.film.stage_video import read_stage_video
from slipstitch.images.camera import pose

CONFIG, SCHEDULE = stage.protocol(300, 8)
START_S = 2.6
# Of a film of the whole protocol: dense until the start has been seen.
TIMES_S = np.concatenate([np.arange(0, 6.0, 0.1), np.arange(6.0, START_S + 126.0, 0.34)])


@functools.cache
def lens(viewpoint="calibrated"):
    return stage.lens_camera(*pose(VIEWPOINTS[viewpoint]))


@functools.cache
def bench(viewpoint="calibrated"):
    return stage.Bench(lens(viewpoint))


def chosen(follower, until_s):
    """Times of the frames that a follower chooses of a film without key frames."""
    times_s = np.arange(6.3, until_s, 0.34)
    return times_s[follower.choose(times_s, np.zeros(len(times_s), bool))]


def follower_of(
    rate=1.0,
    viewpoint="calibrated",
    noise=6.0,
    until_s=124.0,
    clock=lambda t: t,
    flicker=0.0,
    seen=lambda image, time_s: image,
):
    """Has seen a film of the stage; its clock shows `clock` of the true time."""
    schedule = replace(Schedule.of(CONFIG), pose=pose(VIEWPOINTS[viewpoint]))
    follower = StageFollower(lens(viewpoint), schedule)
    random = np.random.default_rng(4)
    for time_s in chosen(follower, until_s):
        image = seen(bench(viewpoint).image(clock(rate * time_s)), time_s)[..., ::-1]
        lamp = 1 + flicker * random.standard_normal()
        noisy = lamp * image + random.normal(0, noise, image.shape)
        follower.add(time_s, np.ascontiguousarray(np.clip(noisy, 0, 255).astype(np.uint8)))
    return follower


def followed(*arguments, **named):
    """The time base of such a film."""
    return follower_of(*arguments, **named).time_base()


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("rate", [0.95, 0.98, 0.995, 1.0, 1.005, 1.02, 1.05])
def test_the_rate_is_told_within_its_uncertainty(rate):
    """A film of 320 x 240 pixels, noise of 6 levels."""
    found = followed(rate)
    assert found.rate == pytest.approx(rate, abs=5e-4)
    assert abs(found.rate - rate) < 4 * found.rate_sd
    assert found.worst_offset_m() < 1.5e-3


@pytest.mark.slow
@pytest.mark.parametrize("viewpoint", ["frontal", "side"])
def test_other_viewpoints_tell_it_too(viewpoint):
    assert followed(1.01, viewpoint).rate == pytest.approx(1.01, abs=1e-3)


def test_a_rate_beyond_those_tried_is_told_where_the_edge_is_seen_and_else_none_is():
    """A stage that is slower than any rate tried, seen in all frames or in fewer than half."""
    assert followed(0.926).rate == pytest.approx(0.926, abs=2e-3)
    random = np.random.default_rng(5)

    def hidden(image, time_s):
        if time_s < 8.0 or time_s % 20 < 9:
            return image
        return random.integers(0, 255, image.shape, dtype=np.uint8)

    assert followed(0.926, seen=hidden) is None


def test_one_stroke_is_enough_and_a_stage_out_of_sight_tells_nothing():
    found = followed(0.99, until_s=36.0)
    assert found.rate == pytest.approx(0.99, abs=2e-3)
    assert found.rate_sd < 2e-3
    random = np.random.default_rng(5)
    dots = {"seen": lambda image, _: random.integers(0, 255, image.shape, dtype=np.uint8)}
    assert followed(until_s=100.0, noise=0.0, **dots) is None


@pytest.mark.slow
@pytest.mark.parametrize("missing_s", [1.0, 2.0])
def test_a_film_that_was_cut_is_noticed(missing_s):
    """Seconds of the third stroke are missing: the rate is wrong, or none explains the rest."""
    found = followed(clock=lambda time_s: time_s + missing_s * (time_s > 80.0))
    assert abs(found.rate - 1) >= 0.005 or found.worst_offset_m() > 4e-3


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("stops_s", [22.0, 60.0, 95.0])
@pytest.mark.parametrize(("noise", "flicker"), [(1.0, 0.0), (20.0, 0.05)])
def test_a_stage_that_stops_is_noticed(stops_s, noise, flicker):
    seen = {"noise": noise, "flicker": flicker, "until_s": stops_s + 29.0}
    stopped = follower_of(clock=lambda time_s: min(time_s, stops_s), **seen)
    assert stopped.still_from_s(stopped.time_base()) == pytest.approx(stops_s, abs=15.0)
    moving = follower_of(**seen)
    assert moving.still_from_s(moving.time_base()) is None


def test_somebody_who_walks_past_stops_no_stage():
    def with_a_bar(image, time_s):
        if 60.0 <= time_s <= 70.0:
            width = image.shape[1]
            left = round((((time_s - 60.0) % 5.0) / 5.0 * 1.24 - 0.24) * width)
            image[:, max(left, 0) : max(left + round(0.24 * width), 0)] = 20
        return image

    follower = follower_of(seen=with_a_bar, until_s=90.0)
    assert follower.still_from_s(None) is not None  # by the brightness alone
    assert follower.still_from_s(follower.time_base()) is None


@pytest.mark.slow
def test_a_film_of_a_stage_that_stops_is_refused(tmp_path):
    images = (bench().image(np.clip(time_s - START_S, 0.0, 30.0)) for time_s in TIMES_S)
    path = stage.write_video(tmp_path / "stops.mp4", images, TIMES_S, preset="ultrafast")
    with pytest.raises(BadInput, match=r"about 3\d s after the start on nothing moves.* stop\?"):
        read_stage_video(path, lens(), SCHEDULE)


def test_offsets_of_ten_seconds_count_not_single_ones():
    offset_m = np.zeros(40)
    offset_m[[3, 17]] = 0.02
    calm = TimeBase(1.0, 1e-4, np.arange(40.0), offset_m)
    assert calm.worst_offset_m() == 0.0
    offset_m[20:30] = -0.004
    # The last frame, in a block of its own, is one bad place and not 10 s of them.
    last = TimeBase(1.0, 1e-4, np.arange(41.0), np.append(offset_m, 0.02))
    assert last.worst_offset_m() == 0.004
    assert TimeBase(1.0, 1e-4, np.arange(40.0), offset_m).worst_offset_m() == 0.004


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    """Films of the whole protocol played at a rate: its clock is wrong by that."""

    @functools.cache
    def play(rate, until_s=START_S + 126.0):
        times_s = TIMES_S[: np.searchsorted(TIMES_S, until_s)]
        images = (bench().image(max(time_s - START_S, 0.0)) for time_s in times_s)
        path = tmp_path_factory.mktemp("films") / f"{rate}_{until_s}.mp4"
        return stage.write_video(path, images, times_s / rate, preset="ultrafast")

    return play


@pytest.mark.slow
@pytest.mark.parametrize(("rate", "notes"), [(1.0, 0), (1.01, 1)])
def test_a_clock_slightly_wrong_is_corrected_and_noted_and_a_right_one_left_alone(
    film, rate, notes
):
    video = read_stage_video(film(rate), lens(), SCHEDULE)
    assert video.time_base.rate == pytest.approx(rate, abs=5e-4 if rate == 1 else 1e-3)
    assert video.time_s == pytest.approx(SCHEDULE.time_s, abs=0.25)
    assert [note[:17] for note in video.notes] == ["the stage moves 1"] * notes


def test_the_speed_of_a_capture_is_that_of_its_clock(film, tmp_path, monkeypatch):
    """As `slipstitch measure` tells it, not that of the drop alone."""
    config, schedule = stage.protocol(150, 8)
    stage.camera_file(lens(), tmp_path / "camera.json")
    os.link(film(1.01, START_S + schedule.time_s[-1] + 2.0), tmp_path / "film.mp4")
    columns = "video,material,substrate,repeat,mu_ref,mu_ref_error,reflective,camera"
    row = "film.mp4,gray-interlock,glass,1,0.31,0.02,no,camera.json"
    (tmp_path / "captures.csv").write_text(f"{columns}\n{row}\n")
    videos = []

    def kept(*arguments, **options):
        videos.append(read_stage_video(*arguments, **options))
        return videos[-1]

    monkeypatch.setattr("slipstitch.film.ingest_videos.read_stage_video", kept)
    (known,) = ingest(config, tmp_path / "captures.csv", tmp_path / "dataset")
    assert known["stage_speed"] == videos[0].time_base.rate == pytest.approx(1.01, abs=1e-3)


@pytest.mark.slow
def test_a_clock_three_percent_wrong_is_refused(film):
    with pytest.raises(BadInput, match=r"the stage moves 0\.97.*--frame-rate-hz"):
        read_stage_video(film(0.97), lens(), SCHEDULE)


# The start of the stage is found by the cloth, whatever stands still around it

BEGINS_S = 3.3
CALIBRATED = VIEWPOINTS["calibrated"]


def camera_at(turn_deg, raise_deg):
    """Beside and above the calibrated viewpoint, and far away: 4 mm a pixel."""
    at = CALIBRATED
    azimuth_deg, elevation_deg = at.azimuth_deg + turn_deg, at.elevation_deg + raise_deg
    seen_from = replace(at, azimuth_deg=azimuth_deg, elevation_deg=elevation_deg)
    return stage.lens_camera(*pose(seen_from), size=(224, 168))


# The floor's far edge lies behind the cloth.
ASIDE = camera_at(8.5, 7.5)


def filmed(monkeypatch, lens, cloth, floor=None, clock=lambda time_s: time_s):
    """The moments of a noisy video at 12 frames per second of a cloth on a floor."""
    monkeypatch.setattr(stage, "_cloth_light", cloth)
    bench = stage.Bench(lens)
    if floor is not None:
        bench.floor = np.where(bench.floor > 0.05, floor, 0.006)

    @functools.cache
    def image(time_s):  # drawn when it is looked at
        noise = np.random.default_rng(round(12 * time_s)).normal(0, 2, (*bench.shape, 3))
        noisy = bench.image(time_s - BEGINS_S)[..., ::-1] + noise
        return np.clip(noisy, 0, 255).astype(np.uint8)

    return [
        SimpleNamespace(time_s=clock(time_s), image=functools.partial(image, time_s))
        for time_s in np.arange(0, 14, 1 / 12).tolist()
    ]


def woven(y, down):
    """A weave of little contrast."""
    first = np.sin(2 * np.pi * (1.3 * y + down) / 0.031)
    return 0.35 + 0.05 * (first + np.sin(2 * np.pi * (y - 0.4 * down) / 0.023))


def plain(y, down):
    return np.full_like(y, 0.35)


def start_of(moments, lens):
    return find_start(moments, lens, stage.protocol(300, 30)[1])


@pytest.mark.parametrize(
    ("lens", "cloth", "floor"),
    [(ASIDE, woven, 0.7), (camera_at(12.0, 4.0), woven, 0.7), (ASIDE, plain, None)],
)
def test_the_start_is_that_of_the_cloth_not_of_what_stands_still(monkeypatch, lens, cloth, floor):
    """As the edge of a bright floor behind; a plain cloth is followed by its upper edge."""
    moments = filmed(monkeypatch, lens, cloth, floor)
    start = start_of(moments, lens)
    assert start.time_s == pytest.approx(BEGINS_S, abs=0.03 if floor else 0.05)
    assert start.speed == pytest.approx(1, abs=0.02) if floor else start.speed_is_right
    if floor:  # the wide strip alone is held, or slowed down, by what stands still
        monkeypatch.setattr(stage_start, "_STRIPS_M", stage_start._STRIPS_M[:1])
        wide = start_of(moments, lens)
        assert wide is None if lens is ASIDE else not wide.speed_is_right


def test_a_stage_at_another_speed_is_found_at_that_speed_and_one_that_stands_still_nowhere(
    monkeypatch,
):
    lens = camera_at(0.0, 0.0)
    moments = filmed(monkeypatch, lens, woven, clock=lambda s: BEGINS_S + 1.25 * (s - BEGINS_S) + 1)
    start = start_of(moments, lens)
    assert start.speed == pytest.approx(0.8, abs=0.03)
    assert not start.speed_is_right
    still = [SimpleNamespace(time_s=one.time_s, image=moments[0].image) for one in moments]
    assert start_of(still, lens) is None
