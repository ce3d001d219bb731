"""From a video of the bench to the input frames of a network."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.film.frame_schedule import Schedule
from slipstitch.film.recording import Recording
from slipstitch.film.stage_start import StageStart, find_start
from slipstitch.film.time_base import StageFollower, TimeBase
from slipstitch.images.camera import AIM_M, Camera, relative_pose
from slipstitch.images.mean_cloth import cloth_surface
from slipstitch.images.rectification import fine_source_pixels, in_image, rectify, source_pixels

# A frame this near to the wanted moment is as good as it (the stage moves 2.5 mm); one farther away
# than the second number is of another moment.
_NEAR_S = 0.25
_LARGEST_GAP_S = 1.0
# A start is found to 0.03 s. In the example that ships, one stated this much too early or too late
# moves friction by its error bar or little more, one 0.45 s too early by four times as much.
_NEAR_START_S = 0.2
_FAR_VIEW_DEG = 5.0
_LEAST_INSIDE = 0.8
# Instruments learn from 1.25 camera pixels for each of theirs (render.bench_camera.oversampling).
_LEAST_SAMPLING = 0.8
# A film's clock: corrected from here on if it is told that closely, noted, refused; and how far the
# stage may stand from the path at any time.
_CORRECTED_RATE, _NOTED_RATE, _REFUSED_RATE = 0.001, 0.005, 0.02
_CERTAIN = 3.0
_NOTED_OFFSET_M, _REFUSED_OFFSET_M = 0.004, 0.008
# A shorter part of the drag does not tell a clock, and is not spoilt by a wrong one.
_SHORTEST_DRAG_S = 15.0
# How a user gives what cannot be found: to `measure`, and in the table of `capture ingest`.
_GIVE_START = "--start-s, or start_s in a captures table"
_GIVE_RATE = "--frame-rate-hz, or frame_rate_hz in a captures table"


@dataclass(frozen=True)
class StageVideo:
    """A real video as the networks see it.

    Attributes
    ----------
    frames : ndarray (n, pixels, pixels, 3) uint8
        Red, green, blue.
    time_s : ndarray (n,)
        Of each frame, from the start of the stage's motion.
    stage_x_m : ndarray (n,)
    start : StageStart
    time_base : TimeBase or None
        The video's clock relative to the stage; None if too little of the drag was detected.
    frame_interval_s, longest_gap_s : float
        Median and largest time between frames of the file, while the protocol ran.
    view_angle_deg : float
        Between the directions in which the real camera and the calibrated viewpoint stand.
    pose : dict
        Pose of the camera relative to that viewpoint, see `slipstitch.images.camera.POSE`.
    inside : ndarray (n,)
        Share of each image that the real camera saw.
    notes : list of str
        What a person should know before trusting the result.
    """

    frames: np.ndarray
    time_s: np.ndarray
    stage_x_m: np.ndarray
    start: StageStart
    time_base: TimeBase | None
    frame_interval_s: float
    longest_gap_s: float
    view_angle_deg: float
    pose: dict[str, float]
    inside: np.ndarray
    notes: list[str] = field(default_factory=list)


def read_stage_video(
    path: str | os.PathLike,
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
    path : path
    lens : Camera
        The camera that took it, at the stage.
    schedule : Schedule
        Which moments, through which crop.
    start_s : float, optional
        Time in the video at which the stage starts; found in the frames by default. One that the
        frames contradict is refused, one that they do not confirm is noted.
    frame_rate_hz : float, optional
        Of the camera, where the file's times are wrong.
    note_far_view : bool
        Whether a camera aside of the viewpoint is worth a note: it is not to who knows its pose.

    Raises
    ------
    BadInput
        If the file is no video, of another size than the camera's images, too short, has gaps, or
        does not show a stage that moves as the protocol says.
    """
    recording = Recording(path, frame_rate_hz)
    _check_size(recording, lens)
    notes = []
    if start_s is not None:
        start = StageStart(start_s, False)
        if not _start_is_seen(recording, lens, schedule, start_s):
            notes.append(
                "the stated start could not be verified: no start was found in the frames; a wrong "
                "start makes the friction wrong"
            )
    else:
        found = find_start(recording.moments(), lens, schedule.crop(0.0), schedule.path)
        start = _checked_start(path, found)
    followed = schedule.time_s[-1] >= schedule.path.drop_duration_s + _SHORTEST_DRAG_S
    chosen, intervals, follower = _choose(
        recording,
        schedule.time_s,
        start.time_s,
        lambda: StageFollower(lens, schedule.crop(0.0), schedule.path) if followed else None,
    )
    time_base = follower.time_base() if follower else None
    if follower and (still_s := follower.still_from_s(time_base)) is not None:
        raise BadInput(
            f"{path}: about {still_s:.0f} s after the start on nothing moves for several seconds: "
            "did the stage stop?"
        )
    rate = _checked_rate(path, time_base)
    if rate != 1.0:
        chosen, intervals, _ = _choose(recording, schedule.time_s / rate, start.time_s)
    frames, inside, time_s = [], [], []
    for moment_s, image in chosen:
        at_s = rate * (moment_s - start.time_s)
        crop = schedule.crop(max(at_s, 0.0))
        surface = cloth_surface(crop, schedule.cloth(max(at_s, 0.0)))
        picture, share = rectify(image, lens, crop, surface)
        frames.append(picture[..., ::-1])
        inside.append(share)
        time_s.append(at_s)
    if problem := _seen_too_little(inside, time_s):
        raise BadInput(f"{path}: {problem}")
    video = StageVideo(
        frames=np.stack(frames),
        time_s=np.array(time_s),
        stage_x_m=schedule.path.position_m(np.maximum(time_s, 0.0))[0],
        start=start,
        time_base=time_base,
        frame_interval_s=float(np.median(intervals)),
        longest_gap_s=float(np.max(intervals)),
        view_angle_deg=_view_angle_deg(lens, schedule),
        pose=relative_pose(lens.pose, schedule.pose),
        inside=np.array(inside),
        notes=notes,
    )
    video.notes.extend(_notes(video, schedule, corrected=rate != 1.0))
    if note_far_view and video.view_angle_deg > _FAR_VIEW_DEG:
        video.notes.append(
            f"the camera is {video.view_angle_deg:.0f} degrees from the calibrated viewpoint"
        )
    return video


def seen_shares(lens: Camera, schedule: Schedule) -> np.ndarray:
    """Share of each image of a schedule that a camera sees, shape (n,); needs no video."""
    columns, rows = lens.size_px
    shares = []
    for time_s in map(float, schedule.time_s):
        crop = schedule.crop(time_s)
        place = fine_source_pixels(lens, crop, cloth_surface(crop, schedule.cloth(time_s)))
        shares.append(in_image(place, columns, rows).mean())
    return np.array(shares)


def _seen_too_little(
    shares: Sequence[float] | np.ndarray, time_s: Sequence[float] | np.ndarray
) -> str:
    """When a camera sees less of a crop than is needed, and how much; empty where it never does.

    Parameters
    ----------
    shares : sequence of float, length n
        Of each crop.
    time_s : sequence of float, length n
        From the start of the stage's motion.
    """
    worst = int(np.argmin(shares))
    if shares[worst] >= _LEAST_INSIDE:
        return ""
    return (
        f"{time_s[worst]:.1f} s after the start the camera sees only "
        f"{100 * shares[worst]:.0f} % of the crop; at least {100 * _LEAST_INSIDE:.0f} % needed"
    )


def problem_of_view(lens: Camera, schedule: Schedule, shares: np.ndarray) -> str:
    """Why a camera sees too little of the crops, or too coarsely; empty where it sees enough.

    ``shares`` (n,) as `seen_shares` gives them.
    """
    return _seen_too_little(shares, schedule.time_s) or _seen_too_coarsely(lens, schedule)


def _seen_too_coarsely(lens: Camera, schedule: Schedule) -> str:
    """How few pixels a camera that sees the crop has for each of its; empty if enough."""
    crop = schedule.crop(0.0)
    place = source_pixels(lens, crop, cloth_surface(crop, schedule.cloth(0.0)))
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


def _checked_start(path, start: StageStart | None) -> StageStart:
    if start is None:
        raise BadInput(
            f"{path}: no start of the stage's motion found: the cloth must hang still for 2 s, "
            f"then descend as in the protocol; if it does, give the start ({_GIVE_START})"
        )
    if not start.speed_is_right:
        raise BadInput(
            f"{path}: the stage descends {start.speed:.2f} times as fast as in the protocol; if "
            f"the frame rate is wrong, give the correct one ({_GIVE_RATE})"
        )
    return start


def _start_is_seen(recording: Recording, lens: Camera, schedule: Schedule, start_s: float) -> bool:
    """Whether the stage starts where it is stated to; BadInput if only elsewhere.

    A film may show another start before the one that counts.
    """
    moments, seen_s = recording.moments(), []
    while found := find_start(moments, lens, schedule.crop(0.0), schedule.path):
        if found.speed_is_right:
            seen_s.append(found.time_s)
        if found.time_s > start_s:
            break
    if not seen_s:
        return False
    nearest_s = min(seen_s, key=lambda time_s: abs(time_s - start_s))
    if abs(nearest_s - start_s) > _NEAR_START_S:
        raise BadInput(
            f"{recording.path}: the stage is seen to start at {nearest_s:.2f} s, but {start_s:.2f} "
            f"s is stated; at most {_NEAR_START_S:g} s difference is allowed: leave the start out"
        )
    return True


def _checked_rate(path, time_base: TimeBase | None) -> float:
    """The stage's speed in the video's time, to select frames by; BadInput if it is wrong."""
    if time_base is None:
        return 1.0
    off = time_base.rate - 1
    if abs(off) > _REFUSED_RATE:
        raise BadInput(
            f"{path}: the stage moves {time_base.rate:.4f} ± {time_base.rate_sd:.4f} times as "
            f"fast as in the protocol; at most {100 * _REFUSED_RATE:g} % deviation is allowed; "
            f"if the frame rate is wrong, give the correct one ({_GIVE_RATE})"
        )
    worst_m = time_base.worst_offset_m()
    if worst_m > _REFUSED_OFFSET_M:
        raise BadInput(
            f"{path}: for 10 s the stage is {1e3 * worst_m:.0f} mm from its path in the "
            f"protocol; at most {1e3 * _REFUSED_OFFSET_M:g} mm are allowed: was the video cut, "
            "or did the stage stop?"
        )
    certain = abs(off) > max(_CERTAIN * time_base.rate_sd, _CORRECTED_RATE)
    return time_base.rate if certain else 1.0


def _choose(
    recording: Recording,
    protocol_s: np.ndarray,
    start_s: float,
    new_follower: Callable[[], StageFollower | None] = lambda: None,
) -> tuple[list[tuple[float, np.ndarray]], np.ndarray, StageFollower | None]:
    """The frame nearest to each wanted time, and the times between frames from the start on.

    A follower is shown the frames that it wants on the way. Only what these need is decoded, where
    the container lists its frames and all of them turn out to be sound.
    """
    wanted_s = start_s + protocol_s
    follower, index = new_follower(), recording.index
    if index is not None:
        nearest = [int(np.abs(index.time_s - one_s).argmin()) for one_s in wanted_s]
        shown = follower.choose(index.time_s - start_s, index.is_entry) if follower else []
        try:
            return *_chosen(recording, wanted_s, start_s, follower, nearest, shown), follower
        except _DamagedFrameError:
            follower = new_follower()
    return *_chosen(recording, wanted_s, start_s, follower), follower


class _DamagedFrameError(Exception):
    """A frame that the container lists has no image."""


def _chosen(
    recording: Recording,
    wanted_s: np.ndarray,
    start_s: float,
    follower: StageFollower | None,
    nearest: Sequence[int] = (),
    shown: Sequence[int] = (),
) -> tuple[list[tuple[float, np.ndarray]], np.ndarray]:
    """As `_choose`; of all frames, or of those alone whose numbers are known."""
    needed = {*nearest, *shown} if nearest else None
    chosen: list[tuple[float, np.ndarray]] = []
    best: tuple[float, np.ndarray] | None = None
    last_s, intervals = None, []
    for moment in recording.moments(needed):
        now_s = moment.time_s
        if last_s is not None and now_s >= start_s:
            intervals.append(now_s - last_s)
        last_s = now_s
        if needed and moment.number in needed and not moment.has_image:
            raise _DamagedFrameError
        if follower and moment.has_image:
            at_s = now_s - start_s
            is_shown = moment.number in shown if needed else follower.wants(at_s)
            image = moment.image() if is_shown else None
            if image is not None:
                follower.add(at_s, image)
        while len(chosen) < len(wanted_s):
            target_s = wanted_s[len(chosen)]
            near_s = np.inf if best is None else abs(best[0] - target_s)
            if now_s - target_s < near_s:
                break
            # From here on frames only get farther away.
            if best is None or near_s >= _LARGEST_GAP_S:
                raise BadInput(
                    f"{recording.path}: a frame is needed at {target_s:.2f} s; the nearest usable "
                    f"one is {near_s:.1f} s away, at most {_LARGEST_GAP_S:g} s is allowed"
                )
            chosen.append(best)
        if len(chosen) == len(wanted_s):
            break
        left_s = wanted_s[len(chosen)] - now_s
        # The nearer the wanted time, the more frames are converted, every one in the end.
        if left_s < _LARGEST_GAP_S and (best is None or now_s - best[0] >= left_s / 4):
            image = moment.image()
            best = best if image is None else (now_s, image)
    while best and len(chosen) < len(wanted_s) and wanted_s[len(chosen)] - best[0] <= _NEAR_S:
        chosen.append(best)
    if len(chosen) < len(wanted_s):
        raise BadInput(
            f"{recording.path}: ends after {last_s or 0.0:.1f} s; the stage starts at "
            f"{start_s:.1f} s and {wanted_s[-1] - start_s:.1f} s from there are needed"
        )
    return chosen, np.array(intervals or [0.0])


def _view_angle_deg(lens: Camera, schedule: Schedule) -> float:
    directions = []
    for rotation, translation in (lens.pose, schedule.pose):
        seen_from = -rotation.T @ translation - np.array(AIM_M)
        directions.append(seen_from / np.linalg.norm(seen_from))
    return float(np.degrees(np.arccos(np.clip(directions[0] @ directions[1], -1, 1))))


def _notes(video: StageVideo, schedule: Schedule, corrected: bool) -> list[str]:
    notes = []
    off_s = np.abs(video.time_s - schedule.time_s)
    if off_s.max() > _NEAR_S:
        notes.append(
            f"{int((off_s > _NEAR_S).sum())} frame(s) are up to {off_s.max():.2f} s from the "
            "required time, because frames are missing"
        )
    notes += _clock_notes(video.time_base, schedule, corrected)
    if video.inside.min() < 0.999:
        notes.append(
            f"the camera sees only {100 * video.inside.min():.0f} % of a crop; the rest repeats "
            "its border"
        )
    return notes


def _clock_notes(time_base: TimeBase | None, schedule: Schedule, corrected: bool) -> list[str]:
    if time_base is None:
        if schedule.time_s[-1] < schedule.path.drop_duration_s + _SHORTEST_DRAG_S:
            return []
        return [
            "the clock of the video could not be verified: the cloth's upper edge was detected "
            "in too few frames; a wrong frame rate makes the friction wrong"
        ]
    notes = []
    # As far off as it may well be.
    if abs(time_base.rate - 1) + time_base.rate_sd >= _NOTED_RATE:
        notes.append(
            f"the stage moves {time_base.rate:.4f} ± {time_base.rate_sd:.4f} times as fast as in "
            f"the protocol; the frame times were {'' if corrected else 'not '}corrected for it: "
            "check "
            "the frame rate"
        )
    worst_m = time_base.worst_offset_m()
    if worst_m > _NOTED_OFFSET_M:
        notes.append(f"for 10 s the stage is {1e3 * worst_m:.1f} mm from its path in the protocol")
    return notes
