"""From a video of the bench to the input frames of a network."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.film.edge_height import EdgeFinder
from slipstitch.film.frame_schedule import Schedule
from slipstitch.film.recording import FrameIndex, Recording
from slipstitch.film.stage_clock import (
    StageFollower,
    TimeBase,
    checked_rate,
    clock_notes,
    is_followed,
)
from slipstitch.film.stage_start import StageStart, found_start, start_is_seen
from slipstitch.images.camera import AIM_M, Camera, relative_pose
from slipstitch.images.rectification import fine_source_pixels, in_image, rectify, source_pixels

# A frame this near to the wanted moment is as good as it (the stage moves 2.5 mm); one farther away
# than the second number is of another moment.
_NEAR_S = 0.25
_LARGEST_GAP_S = 1.0
_FAR_VIEW_DEG = 5.0
_LEAST_INSIDE = 0.8
# Instruments learn from 1.25 camera pixels for each of theirs (render.bench_camera.oversampling).
_LEAST_SAMPLING = 0.8


@dataclass(frozen=True)
class StageVideo:
    """A real video as the networks see it."""

    frames: np.ndarray  # (n, pixels, pixels, 3) uint8: red, green, blue
    time_s: np.ndarray  # (n,): of each frame, from the start of the stage's motion
    stage_x_m: np.ndarray  # (n,)
    start: StageStart
    # the video's clock relative to the stage; None if too little of the drag was detected
    time_base: TimeBase | None
    # median and largest time between frames of the file, while the protocol ran
    frame_interval_s: float
    longest_gap_s: float
    # between the directions in which the real camera and the calibrated viewpoint stand
    view_angle_deg: float
    # pose of the camera relative to that viewpoint, see `slipstitch.images.camera.POSE`
    pose: dict[str, float]
    edge: EdgeFinder | None  # tells the height of the lowered clamps; None if not followed
    # what a person should know before trusting the result
    notes: list[str]


def read_stage_video(
    path: str | Path,
    lens: Camera,
    schedule: Schedule,
    *,
    start_s: float | None = None,
    frame_rate_hz: float | None = None,
    note_far_view: bool = True,
) -> StageVideo:
    """Decode, synchronise, rectify and crop a video; one of its frames is in memory at a time.

    Parameters
    ----------
    lens, schedule
        The camera that took it, at the stage; which moments, through which crop.
    start_s : float, optional
        Time in the video at which the stage starts; found in the frames by default. One that the
        frames contradict is refused, one that they do not confirm is noted.
    frame_rate_hz : float, optional
        Of the camera, where the file's times are wrong.
    note_far_view : bool
        Whether a camera aside of the viewpoint is worth a note: it is not to who knows its pose.

    BadInput if the file is no video, of another size than the camera's images, too short, has
    gaps, or does not show a stage that moves as the protocol says.
    """
    recording = Recording(path, frame_rate_hz)
    _check_size(recording, lens)
    start, notes = _start(recording, lens, schedule, start_s)
    seen_s, images, intervals, follower = _choose(
        recording,
        schedule.time_s,
        start.time_s,
        lambda: StageFollower(lens, schedule) if is_followed(schedule) else None,
    )
    time_base = follower.time_base() if follower else None
    if follower and (still_s := follower.still_from_s(time_base)) is not None:
        raise BadInput(
            f"{path}: about {still_s:.0f} s after the start on nothing moves for several seconds: "
            "did the stage stop?"
        )
    rate = checked_rate(path, time_base)
    if rate != 1.0:
        seen_s, images, intervals, _ = _choose(recording, schedule.time_s / rate, start.time_s)
    time_s = rate * (seen_s - start.time_s)
    frames, inside = _rectified(images, time_s, lens, schedule)
    if problem := _seen_too_little(inside, time_s):
        raise BadInput(f"{path}: {problem}")
    view_angle_deg = _view_angle_deg(lens, schedule)
    off_s = np.abs(time_s - schedule.time_s)
    if off_s.max() > _NEAR_S:
        notes.append(
            f"{int((off_s > _NEAR_S).sum())} frame(s) are up to {off_s.max():.2f} s from the "
            "required time, because frames are missing"
        )
    notes += clock_notes(time_base, schedule, corrected=rate != 1.0)
    if inside.min() < 0.999:
        notes.append(
            f"the camera sees only {100 * inside.min():.0f} % of a crop; the rest repeats its "
            "border"
        )
    if note_far_view and view_angle_deg > _FAR_VIEW_DEG:
        notes.append(f"the camera is {view_angle_deg:.0f} degrees from the calibrated viewpoint")
    return StageVideo(
        frames=frames,
        time_s=time_s,
        stage_x_m=schedule.path.position_m(np.maximum(time_s, 0.0))[0],
        start=start,
        time_base=time_base,
        frame_interval_s=float(np.median(intervals)),
        longest_gap_s=float(np.max(intervals)),
        view_angle_deg=view_angle_deg,
        pose=relative_pose(lens.pose, schedule.pose),
        edge=follower.edge if follower else None,
        notes=notes,
    )


def _start(
    recording: Recording, lens: Camera, schedule: Schedule, start_s: float | None
) -> tuple[StageStart, list[str]]:
    """The start that was found or stated, and what is to be said of it."""
    if start_s is None:
        return found_start(recording, lens, schedule), []
    notes = []
    if not start_is_seen(recording, lens, schedule, start_s):
        notes.append(
            "the stated start could not be verified: no start was found in the frames; a wrong "
            "start makes the friction wrong"
        )
    return StageStart(start_s, False), notes


def _rectified(
    images: list[np.ndarray], time_s: np.ndarray, lens: Camera, schedule: Schedule
) -> tuple[np.ndarray, np.ndarray]:
    """Images at times from the start as the calibrated view has them, and how much of each."""
    frames, inside = [], []
    for image, at_s in zip(images, np.maximum(time_s, 0.0).tolist(), strict=True):
        picture, share = rectify(image, lens, *schedule.seen(at_s))
        frames.append(picture[..., ::-1])
        inside.append(share)
    return np.stack(frames), np.array(inside)


def seen_shares(lens: Camera, schedule: Schedule) -> np.ndarray:
    """Share of each image of a schedule that a camera sees, shape (n,); needs no video."""
    places = (fine_source_pixels(lens, *schedule.seen(float(one))) for one in schedule.time_s)
    return np.array([in_image(place, *lens.size_px).mean() for place in places])


def _seen_too_little(shares: np.ndarray, time_s: np.ndarray) -> str:
    """When a camera sees less of a crop than is needed, and how much; empty where it never does."""
    worst = int(np.argmin(shares))
    if shares[worst] >= _LEAST_INSIDE:
        return ""
    return (
        f"{time_s[worst]:.1f} s after the start the camera sees only "
        f"{100 * shares[worst]:.0f} % of the crop; at least {100 * _LEAST_INSIDE:.0f} % needed"
    )


def problem_of_view(lens: Camera, schedule: Schedule, shares: np.ndarray) -> str:
    """Why a camera sees too little, by its `seen_shares`, or too coarsely; empty if it does not."""
    return _seen_too_little(shares, schedule.time_s) or _seen_too_coarsely(lens, schedule)


def _seen_too_coarsely(lens: Camera, schedule: Schedule) -> str:
    """How few pixels a camera that sees the crop has for each of its; empty if enough."""
    place = source_pixels(lens, *schedule.seen(0.0))
    steps = [np.linalg.norm(np.diff(place, axis=axis), axis=-1) for axis in (0, 1)]
    sampling = min(float(np.nanmedian(step)) for step in steps)
    if sampling >= _LEAST_SAMPLING:
        return ""
    return (
        f"the camera has {sampling:.2g} pixels for each of the instrument's; at least "
        f"{_LEAST_SAMPLING:g} needed: nearer, a longer focal length or a finer film (is focal_px "
        "in pixels?)"
    )


def _check_size(recording: Recording, lens: Camera) -> None:
    needed = lens.size_px
    if recording.size_px == needed:
        return
    turned = recording.size_px == needed[::-1]
    shape = "portrait" if recording.size_px[1] > recording.size_px[0] else "landscape"
    hint = f" ({shape}: the camera was calibrated in the other orientation)" if turned else ""
    raise BadInput(
        f"{recording.path}: {recording.size_px[0]}x{recording.size_px[1]} pixels{hint}; "
        f"the camera file is for {needed[0]}x{needed[1]}"
    )


def _choose(
    recording: Recording,
    protocol_s: np.ndarray,
    start_s: float,
    new_follower: Callable[[], StageFollower | None] = lambda: None,
) -> tuple[np.ndarray, list[np.ndarray], np.ndarray, StageFollower | None]:
    """Time and image of the frame nearest to each wanted time; times between frames from the start.

    A follower is shown the frames that it chooses on the way. Only what these need is decoded,
    where the container lists its frames and all of them turn out to be sound.
    """
    if recording.listed is not None:
        follower = new_follower()
        chosen = _chosen(recording, recording.listed, start_s + protocol_s, start_s, follower)
        if chosen is not None:
            return *chosen, follower
    follower = new_follower()
    chosen = _chosen(recording, recording.decoded, start_s + protocol_s, start_s, follower)
    assert chosen is not None
    return *chosen, follower


def _chosen(
    recording: Recording,
    index: FrameIndex,
    wanted_s: np.ndarray,
    start_s: float,
    follower: StageFollower | None,
) -> tuple[np.ndarray, list[np.ndarray], np.ndarray] | None:
    """As `_choose`, of the frames in an index; None if one of them cannot be decoded."""
    time_s = index.time_s
    nearest = [_nearest(recording, time_s, one_s, start_s, wanted_s[-1]) for one_s in wanted_s]
    shown = set(follower.choose(time_s - start_s, index.is_key)) if follower else set()
    shown = {number for number in shown if number <= nearest[-1]}
    needed, images = {*nearest, *shown}, {}
    for number, moment in recording.some(index, needed):
        needed.remove(number)
        image = moment.image()
        if follower and number in shown:
            follower.add(moment.time_s - start_s, image)
        if number in nearest:
            images[number] = image
    if needed:
        return None
    passed_s = time_s[time_s <= max(time_s[nearest[-1]], start_s)]
    intervals = np.diff(passed_s)[passed_s[1:] >= start_s]
    intervals = intervals if len(intervals) else np.zeros(1)
    return time_s[nearest], [images[number] for number in nearest], intervals


def _nearest(
    recording: Recording, time_s: np.ndarray, wanted_s: float, start_s: float, end_s: float
) -> int:
    """The number of the frame that is nearest to a time; BadInput if it is far from it."""
    if not len(time_s) or wanted_s - time_s[-1] > _NEAR_S:
        raise BadInput(
            f"{recording.path}: ends after {time_s[-1] if len(time_s) else 0:.1f} s; the stage "
            f"starts at {start_s:.1f} s and {end_s - start_s:.1f} s from there are needed"
        )
    number = int(np.abs(time_s - wanted_s).argmin())
    away_s = abs(time_s[number] - wanted_s)
    if away_s >= _LARGEST_GAP_S:
        raise BadInput(
            f"{recording.path}: a frame is needed at {wanted_s:.2f} s; the nearest usable one is "
            f"{away_s:.1f} s away, at most {_LARGEST_GAP_S:g} s is allowed"
        )
    return number


def _view_angle_deg(lens: Camera, schedule: Schedule) -> float:
    directions = []
    for rotation, translation in (lens.pose, schedule.pose):
        seen_from = -rotation.T @ translation - np.array(AIM_M)
        directions.append(seen_from / np.linalg.norm(seen_from))
    return float(np.degrees(np.arccos(np.clip(directions[0] @ directions[1], -1, 1))))
