"""The video that comes with Slipstitch, to try the instrument on: a surrogate, not a real one."""

import json
from pathlib import Path

EXAMPLE_FOLDER = Path(__file__).parent
EXAMPLE_VIDEO = EXAMPLE_FOLDER / "film.mp4"
EXAMPLE_CAMERA = EXAMPLE_FOLDER / "camera.json"


def known_of_example() -> str:
    """What the example shows and how it was made, in one sentence."""
    known = json.loads((EXAMPLE_FOLDER / "example.json").read_text(encoding="utf-8"))
    return (
        f"the example is simulated, not real: {known['material']} on {known['substrate']}, "
        f"friction {known['friction']:.3f}; mesh, time step, camera, lens and light are not those "
        "of the training"
    )
