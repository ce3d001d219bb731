"""Schedules: the phases of a training, and the learning rate."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from slipstitch.config.train import TrainSettings

FINE_TUNING, UNTIL_FLAT = "fine-tuning", "until flat"
# Share of the learning rate to which it falls in the last cycle, and at which fine-tuning goes on.
ANNEALED_SHARE = 0.05
CYCLES_MAX = 8  # of epochs until the validation loss is flat


@dataclass(frozen=True)
class Phase:
    """Epochs of the schedule with the same viewpoints."""

    name: str
    viewpoints: tuple[str, ...]
    epochs: int
    # it ends earlier once its lowest validation loss is so old, if the network has left chance
    flat_epochs: int | None = None

    def length(self, rows: Sequence[Mapping[str, Any]], left_chance: float) -> int:
        """Return how many epochs the phase has; below a training loss the network `left_chance`."""
        lowest, age, least = math.inf, 0, math.inf
        for number, row in enumerate(rows[: self.epochs], 1):
            least = min(least, row["train_loss"])
            age = 0 if row["validation_loss"] < lowest else age + 1
            lowest = min(lowest, row["validation_loss"])
            if self.flat_epochs is not None and age >= self.flat_epochs and least < left_chance:
                return number
        return self.epochs


def place(
    phases: Sequence[Phase], history: Sequence[Mapping[str, Any]], left_chance: float
) -> tuple[Phase, int] | None:
    """Return the phase of the next epoch and its number there, from 0; None at the end."""
    first = 0
    for phase in phases:
        length = phase.length(history[first:], left_chance)
        if len(history) < first + length:
            return phase, len(history) - first
        first += length
    return None


def progressive_schedule(
    settings: TrainSettings, view_order: Sequence[str], twice_as_many: bool = False
) -> list[Phase]:
    """Return cycles of one, two ... viewpoints, then the first one alone.

    With `settings.flat_epochs` epochs of all viewpoints come before the last cycle, which lowers
    the rate: until the lowest validation loss is so many epochs old and the network has left
    chance, at most `CYCLES_MAX` cycles. With `twice_as_many` videos there are half as many epochs.
    """
    share = 2 if twice_as_many else 1
    epochs, last = (
        -(-count // share) for count in (settings.epochs_per_cycle, settings.fine_tuning_epochs)
    )
    cycles = [
        Phase(f"cycle {count}", tuple(view_order[:count]), epochs)
        for count in range(1, len(view_order) + 1)
    ]
    if settings.flat_epochs is not None:
        most = CYCLES_MAX * epochs
        cycles.insert(-1, Phase(UNTIL_FLAT, tuple(view_order), most, settings.flat_epochs))
    if last:
        cycles.append(Phase(FINE_TUNING, (view_order[0],), last))
    return cycles


def learning_rate(
    settings: TrainSettings, phases: Sequence[Phase], phase: Phase, done: float
) -> float:
    """Return Adadelta's rate: constant, down a cosine in the last cycle, then as at its end."""
    last_cycle = [other for other in phases if other.name != FINE_TUNING][-1]
    if phase.name == FINE_TUNING:
        height = 0.0
    elif phase is last_cycle:
        height = 0.5 * (1.0 + math.cos(math.pi * done))
    else:
        height = 1.0
    return settings.learning_rate * (ANNEALED_SHARE + (1.0 - ANNEALED_SHARE) * height)
