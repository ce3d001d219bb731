"""An instrument for tests of what surrounds it."""

import torch

from slipstitch.config.instrument import InstrumentSettings
from slipstitch.learning.instrument.measuring import Instrument
from slipstitch.learning.instrument.network import InstrumentNetwork


def untrained_instrument(
    pixels: int = 32, materials=("denim", "felt"), frames: int = 6, **changes
) -> Instrument:
    """An instrument of random weights: well formed, knows nothing, always raises its alarm."""
    settings = InstrumentSettings(**{"channels": [8, 8, 8], "draws": 1} | changes)
    torch.manual_seed(0)
    network = InstrumentNetwork(settings, len(materials), pixels)
    network.eval()
    card = {
        "materials": list(materials),
        "frames": frames,
        "pixels": pixels,
        "bfloat16": False,
        "settings": settings.model_dump(mode="json"),
        "dataset_digest": None,
        "seed": 0,
    }
    return Instrument((network,), card, None)
