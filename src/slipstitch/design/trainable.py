"""What a grid must have to train: told before it is simulated, which takes days at full scale."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from slipstitch.base.errors import BadInput
from slipstitch.config.train import BY_SIMULATION

if TYPE_CHECKING:
    from slipstitch.config.model import Config

FEWEST = 2


def check_networks_can_train(config: Config) -> None:
    """Refuse a grid that leaves a network without classes to tell apart.

    Raises
    ------
    BadInput
        With a single fabric or friction coefficient, or a fabric that never trains.
    """
    _enough(config, "materials", "the material network")
    _enough(config, "frictions", "a friction network")
    if config.sample.validation_materials and BY_SIMULATION in config.train.splits:
        raise BadInput(
            "sample.validation_materials: the material network must see every fabric in training, "
            f"but {BY_SIMULATION} (train.splits) keeps {config.sample.validation_materials[0]} "
            "from it; it is for the instrument alone"
        )


def check_instrument_can_train(config: Config) -> None:
    """Refuse a grid whose friction coefficients the instrument cannot learn.

    Raises
    ------
    BadInput
        With a single coefficient, or one above what the instrument can say.
    """
    _enough(config, "frictions", "the instrument")
    for key in ("frictions", "test_frictions"):
        largest = max(getattr(config.grid, key), default=0.0)
        if largest > config.instrument.friction_max:
            raise BadInput(
                f"grid.{key}: {largest:g} is above what the instrument can say, "
                f"{config.instrument.friction_max:g} (instrument.friction_max)"
            )


def check_calibration_datasets(config: Config) -> None:
    """Refuse datasets of other runs that are not there: they are to be made before.

    Raises
    ------
    BadInput
        Names the first.
    """
    for folder in config.instrument.calibration_datasets:
        if not Path(folder, "manifest.parquet").is_file():
            raise BadInput(
                f"instrument.calibration_datasets: {folder}: no manifest.parquet there; make that "
                "run's dataset first (target sample)"
            )


def _enough(config: Config, key: str, learner: str) -> None:
    count = len(getattr(config.grid, key))
    if count < FEWEST:
        raise BadInput(f"grid.{key}: has {count}; {learner} requires at least {FEWEST}")
