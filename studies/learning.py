"""Training: videos per second, and deviation of bfloat16 gradients from float32.

    python studies/learning.py [--threads 2] [--pixels 64 112] [--steps 6]

The networks have their default sizes, the videos are drawn (tests/support/synthetic_videos.py) with
noise; a step is all that a training does with a batch: augmentation, forward, backward, optimiser.
"""

import argparse
import math
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import numpy as np
import torch
from support import synthetic_videos

from slipstitch.config.train import InstrumentSettings, TrainSettings
from slipstitch.learning.instrument.network import InstrumentNetwork
from slipstitch.learning.instrument.training import losses, training_views
from slipstitch.learning.lrcn import LRCN
from slipstitch.learning.torch_setup import computes_bfloat16, set_up_torch

FRAMES = 30
CLASSES = 10


def drawn_videos(count: int, frames: int, pixels: int) -> np.ndarray:
    """Noisy videos, uint8 of shape (count, frames, pixels, pixels, 3), no two the same."""
    rng = np.random.default_rng(0)
    lags, turn = rng.uniform(0, 0.4, count), 4 * math.pi / frames
    videos = np.array(
        [
            [
                synthetic_videos.draw(pixels, math.sin(turn * t), lag, 0.5, n % 3, n % 2)
                for t in range(frames)
            ]
            for n, lag in enumerate(lags)
        ]
    )
    return np.clip(videos + rng.normal(0, 4, videos.shape), 0, 255).astype(np.uint8)


def timed(step: Callable[[], None], steps: int) -> tuple[float, float]:
    """Median wall and CPU seconds of a step, after one that does not count."""
    step()
    wall, cpu = [], []
    for _ in range(steps):
        before_s, used_s = time.perf_counter(), time.process_time()
        step()
        wall.append(time.perf_counter() - before_s)
        cpu.append(time.process_time() - used_s)
    return float(np.median(wall)), float(np.median(cpu))


def lrcn_step(network: LRCN, frames: torch.Tensor, bfloat16: bool) -> Callable[[], None]:
    """A step of the paper's network."""
    optimizer = torch.optim.Adadelta(network.parameters(), lr=1.0, rho=0.95)
    truth = torch.arange(len(frames)) % CLASSES

    def step():
        optimizer.zero_grad()
        torch.nn.functional.cross_entropy(network(frames, None, bfloat16), truth).backward()
        optimizer.step()

    return step


def lrcn_of(frames: torch.Tensor, **changes) -> LRCN:
    """The paper's network at a quarter width, ready for these frames."""
    torch.manual_seed(0)
    network = LRCN(TrainSettings(**changes), CLASSES, frames.shape[2])
    network.mean.fill_(frames.float().mean())
    network.deviation.fill_(frames.float().std())
    return network


def cosine(network: LRCN, frames: torch.Tensor) -> float:
    """Between the gradients in bfloat16 and in float32, over all weights."""
    truth, gradients = torch.arange(len(frames)) % CLASSES, []
    for bfloat16 in (False, True):
        network.zero_grad()
        torch.nn.functional.cross_entropy(network(frames, None, bfloat16), truth).backward()
        gradients.append(torch.cat([weight.grad.flatten() for weight in network.parameters()]))
    return torch.nn.functional.cosine_similarity(*gradients, dim=0).item()


def instrument_step(videos: np.ndarray, bfloat16: bool) -> Callable[[], None]:
    """A step of the instrument, which draws FRAMES of the videos' frames."""
    settings, count = InstrumentSettings(), len(videos)
    torch.manual_seed(0)
    network = InstrumentNetwork(settings, 3, videos.shape[2])
    optimizer = torch.optim.AdamW(network.parameters())
    friction, material = torch.linspace(0.1, 1.0, count), torch.arange(count) % 3
    generator = np.random.default_rng(0)

    def step():
        views, ordered, _ = training_views(videos, FRAMES, settings, generator)
        part = losses(network, views, friction, material, ordered, bfloat16)
        optimizer.zero_grad()
        (part["friction"] + part["material"] + part["order"]).backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()

    return step


def say(name: str, videos: int, wall_s: float, cpu_s: float) -> None:
    print(
        f"{name}: {1e3 * wall_s:.0f} ms a step of {videos} videos ({1e3 * cpu_s:.0f} ms CPU), "
        f"{videos / wall_s:.1f} videos/s ({videos / cpu_s:.1f} a CPU s)",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--pixels", type=int, nargs="+", default=[64, 112])
    parser.add_argument("--steps", type=int, default=6)
    chosen = parser.parse_args()
    set_up_torch(chosen.threads)
    bfloat16 = computes_bfloat16("auto")
    print(f"{chosen.threads} threads, load {os.getloadavg()[0]:.1f}, bfloat16 {bfloat16}")
    for pixels in chosen.pixels:
        videos = drawn_videos(8, 2 * FRAMES, pixels)
        say(
            f"instrument, {pixels} pixels",
            len(videos),
            *timed(instrument_step(videos, bfloat16), chosen.steps),
        )
        for count in (2, 4):
            frames = torch.from_numpy(videos[:count, ::2].copy())
            for reduced in sorted({False, bfloat16}):
                name = "bfloat16" if reduced else "float32"
                step = lrcn_step(lrcn_of(frames), frames, reduced)
                say(f"LRCN, {pixels} pixels, {name}", count, *timed(step, chosen.steps))
            if bfloat16:
                network = lrcn_of(frames)
                network.fully_connected[2].p = 0.0  # no dropout
                first, step = cosine(network, frames), lrcn_step(network, frames, True)
                for _ in range(10):
                    step()
                print(
                    f"LRCN, {pixels} pixels, {count} videos: cosine of gradients {first:.6f}, "
                    f"after 10 steps {cosine(network, frames):.6f}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
