"""Whether a film shows the stage as the protocol moves it: its start, its clock, and why not."""

import contextlib
import functools
from itertools import islice

import cv2
import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.film.frame_schedule import Schedule
from slipstitch.film.recording import Moment, Recording
from slipstitch.film.stage_clock import TimeBase
from slipstitch.film.stage_start import Search, StageStart, find_start
from slipstitch.images.camera import Camera

# A start is found to 0.03 s. In the example that ships, one stated this much too early or too late
# moves friction by its error bar or little more, one 0.45 s too early by four times as much.
_NEAR_START_S = 0.2
# A film's clock: corrected from here on if it is told that closely, noted, refused; and how far the
# stage may stand from the path at any time.
_CORRECTED_RATE, _NOTED_RATE, _REFUSED_RATE = 0.001, 0.005, 0.02
_CERTAIN = 3.0
_NOTED_OFFSET_M, _REFUSED_OFFSET_M = 0.004, 0.008
#: A shorter part of the drag does not tell a clock, and is not spoilt by a wrong one.
SHORTEST_DRAG_S = 15.0
# By how much slow motion is slowed down.
_SLOWED = (2, 4, 8, 16)
# A frame is a repeat of the one before if it differs by less than this share of what frames differ
# by; so many of them, in so many frames, are no accident.
_REPEAT_SHARE, _LEAST_REPEATS, _FRAMES_COMPARED = 0.2, 0.12, 120
# How a user gives what cannot be found: to `measure`, and in the table of `capture ingest`.
_GIVE_START = "--start-s, or start_s in a captures table"
_GIVE_RATE = "--frame-rate-hz, or frame_rate_hz in a captures table"


def found_start(recording: Recording, lens: Camera, schedule: Schedule) -> StageStart:
    """Return the start of the stage's motion; BadInput, with the likeliest cause, if none."""
    start = find_start(recording.moments(), lens, schedule.crop(0.0), schedule.path)
    if start is not None and start.speed_is_right:
        return start
    _check_stated_rate(recording, lens, schedule)
    slowed, from_s, is_turned = _other_start(recording, lens, schedule)
    if is_turned:
        tag = recording.rotation_deg
        said = f" (its orientation tag says {tag} degrees)" if tag else ""
        raise BadInput(
            f"{recording.path}: shows the bench upside down{said}: film, and calibrate the camera, "
            "in the same orientation"
        )
    if start is not None and not slowed:
        from_s = start.time_s
    elif not slowed:
        raise BadInput(
            f"{recording.path}: no start of the stage's motion found: the cloth must hang still "
            f"for 2 s, then descend as in the protocol; if it does, give the start ({_GIVE_START})"
        )
    speed = 1 / slowed if slowed else (start and start.speed) or 0.0
    rate_hz, share = _rate_and_repeats(recording, from_s)
    if share >= _LEAST_REPEATS:
        why = (
            f"; {100 * share:.0f} % of the frames repeat the one before, as where a film was "
            "brought to a constant frame rate: give the film as the camera wrote it"
        )
    elif slowed and recording.frame_rate_hz is None:
        why = (
            f", as in slow motion, filmed at {slowed * rate_hz:.4g} and saved at {rate_hz:.4g} "
            f"frames a second: give the rate at which it was filmed ({_GIVE_RATE})"
        )
    else:
        why = f"; if the frame rate is wrong, give the correct one ({_GIVE_RATE})"
    raise BadInput(
        f"{recording.path}: the stage descends {speed:.2f} times as fast as in the protocol{why}"
    )


def _check_stated_rate(recording: Recording, lens: Camera, schedule: Schedule) -> None:
    """Refuse a stated frame rate where the film's own times are right."""
    if recording.frame_rate_hz is None:
        return
    by_itself = Recording(recording.path)
    own = None
    with contextlib.suppress(BadInput):  # its times are none, or start again
        own = find_start(by_itself.moments(), lens, schedule.crop(0.0), schedule.path)
    if own is not None and own.speed_is_right:
        _, share = _rate_and_repeats(by_itself, own.time_s)
        why = ", in which frames are repeated" if share >= _LEAST_REPEATS else ""
        raise BadInput(
            f"{recording.path}: at {recording.frame_rate_hz:g} frames a second the stage does not "
            f"move as in the protocol; by the film's own times{why}, it does: leave the frame rate "
            "out"
        )


def _other_start(recording: Recording, lens: Camera, schedule: Schedule) -> tuple[int, float, bool]:
    """How many times slower a start is seen (0: not), when, and whether upside down."""
    crop, path = schedule.crop(0.0), schedule.path
    slowed = {factor: Search(lens, crop, path) for factor in _SLOWED}
    turned = Search(lens, crop, path)
    for moment in recording.moments():
        for factor, search in slowed.items():
            is_over = search.add(moment.time_s / factor, moment.image)
            if is_over and search.start and search.start.speed_is_right:
                return factor, factor * search.start.time_s, False
        is_over = turned.add(moment.time_s, functools.partial(_upside_down, moment))
        if is_over and turned.start and turned.start.speed_is_right:
            return 0, turned.start.time_s, True
    return 0, 0.0, False


def _upside_down(moment: Moment) -> np.ndarray:
    return cv2.rotate(moment.image(), cv2.ROTATE_180)


def _rate_and_repeats(recording: Recording, from_s: float) -> tuple[float, float]:
    """Frame rate from a time on, and share of frames that show what the one before shows."""
    later = (moment for moment in recording.moments() if moment.time_s >= from_s)
    times_s, small = [], []
    for moment in islice(later, _FRAMES_COMPARED):
        times_s.append(moment.time_s)
        image = cv2.resize(moment.image(), (96, 72), interpolation=cv2.INTER_AREA)
        small.append(image.astype(np.float32))
    if len(small) < 2:
        return 0.0, 0.0
    differ = np.abs(np.diff(small, axis=0)).mean(axis=(1, 2, 3))
    repeated = differ < _REPEAT_SHARE * np.percentile(differ, 90)
    return 1 / float(np.median(np.diff(times_s))), float(repeated.mean())


def start_is_seen(recording: Recording, lens: Camera, schedule: Schedule, start_s: float) -> bool:
    """Return whether the stage starts where it is stated to; BadInput if only elsewhere.

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


def checked_rate(path, time_base: TimeBase | None) -> float:
    """Return the stage's speed in the video's time, to select frames by; BadInput if wrong."""
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


def is_followed(schedule: Schedule) -> bool:
    """Whether a schedule shows enough of the drag to tell a film's clock."""
    return bool(schedule.time_s[-1] >= schedule.path.drop_duration_s + SHORTEST_DRAG_S)


def clock_notes(time_base: TimeBase | None, schedule: Schedule, corrected: bool) -> list[str]:
    """What a person should know of a film's clock."""
    if time_base is None:
        if not is_followed(schedule):
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
            "check the frame rate"
        )
    worst_m = time_base.worst_offset_m()
    if worst_m > _NOTED_OFFSET_M:
        notes.append(f"for 10 s the stage is {1e3 * worst_m:.1f} mm from its path in the protocol")
    return notes
