"""Measure: friction from a video of a bench; the instrument and the example that ship."""

import json
import os
from pathlib import Path
from typing import Any

#: The instrument that comes with Slipstitch: weights, card, and the configuration of its training.
SHIPPED = Path(__file__).with_name("shipped")
#: The video that comes with Slipstitch, to try the instrument on: a surrogate, not a real one.
EXAMPLE_FOLDER = Path(__file__).with_name("example")
EXAMPLE_VIDEO = EXAMPLE_FOLDER / "film.mp4"
EXAMPLE_CAMERA = EXAMPLE_FOLDER / "camera.json"


def truth_of(video: str | Path) -> dict[str, Any] | None:
    """What is known of the example: fabric, substrate, friction; None of any other video."""
    if Path(video) != EXAMPLE_VIDEO:
        return None
    return json.loads((EXAMPLE_FOLDER / "example.json").read_text(encoding="utf-8"))


def known_of_example() -> str:
    """What the example shows and how it was made, in one sentence."""
    known = truth_of(EXAMPLE_VIDEO) or {}
    return (
        f"the example is simulated, not real: {known['material']} on {known['substrate']}, "
        f"friction {known['friction']:.3f}; mesh, time step, camera, lens and light are not those "
        "of the training"
    )
