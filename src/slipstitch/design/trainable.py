"""What is trained, from which viewpoints, and what a grid must have for it.

The checks tell it before anything is simulated, which takes days at full scale.
"""

from pathlib import Path

from slipstitch.base.errors import BadInput
from slipstitch.config import train as trained
from slipstitch.config.catalogue import VIEWPOINTS
from slipstitch.config.model import Config
from slipstitch.config.train import TrainSettings

FEWEST = 2


def keeps_networks_of_all_views(settings: TrainSettings) -> bool:
    """Return whether a training writes the network before fine-tuning too."""
    return settings.keep_all_views and settings.fine_tuning_epochs > 0


def trainings(train: TrainSettings, trained_on: str) -> list[tuple[str, int]]:
    """Networks and seeds of a training set; on reflective floors only material, then friction."""
    if trained_on == trained.REFLECTIVE:
        networks = ("material_baseline", "friction_conditional")
        return [(network, seed) for network in networks for seed in trained.REFLECTIVE_SEEDS]
    return [(network, seed) for network in trained.NETWORKS for seed in train.seeds]


def view_order(config: Config) -> list[str]:
    """Viewpoints of the training by name, in its order; the first is the calibrated view."""
    own = [name for name in config.render.viewpoints if not VIEWPOINTS[name].drawn]
    return own or list(config.render.viewpoints)


def instrument_views(config: Config) -> list[str]:
    """Viewpoints that the instrument learns from, by name; BadInput if it cannot from one."""
    calibrated = view_order(config)[0]
    for name in config.instrument.viewpoints or ():
        if name not in config.render.viewpoints or not (
            name == calibrated or VIEWPOINTS[name].drawn
        ):
            raise BadInput(
                f"instrument.viewpoints: {name!r} is not trained on in the calibrated view; "
                f"allowed are {calibrated} and those of render.viewpoints of the family bench_1 ..."
            )
    return list(config.instrument.viewpoints or [calibrated])


def check_networks_can_train(config: Config) -> None:
    """Refuse a grid that leaves a network without classes to tell apart."""
    _enough(config, "materials", "the material network")
    _enough(config, "frictions", "a friction network")
    kept = config.sample.validation_materials
    if kept and trained.BY_SIMULATION in config.train.splits:
        raise BadInput(
            "sample.validation_materials: the material network must see every fabric in training, "
            f"but {trained.BY_SIMULATION} (train.splits) keeps {kept[0]} from it; it is for the "
            "instrument alone"
        )


def check_instrument_can_train(config: Config) -> None:
    """Refuse a grid whose friction coefficients the instrument cannot learn."""
    instrument_views(config)
    _enough(config, "frictions", "the instrument")
    for key in ("frictions", "test_frictions"):
        largest = max(getattr(config.grid, key), default=0.0)
        if largest > config.instrument.friction_max:
            raise BadInput(
                f"grid.{key}: {largest:g} is above what the instrument can say, "
                f"{config.instrument.friction_max:g} (instrument.friction_max)"
            )


def check_calibration_datasets(config: Config) -> None:
    """Refuse datasets of other runs that are not there: they are to be made before."""
    remedy = "; make that run's dataset first (target sample)"
    for folder in config.instrument.calibration_datasets:
        _check_there("calibration_datasets", folder, "manifest.parquet", remedy)


def check_starting_weights(config: Config) -> None:
    """Refuse weights to start from that are not there."""
    if config.instrument.starts_from is not None:
        _check_there("starts_from", config.instrument.starts_from, "instrument.safetensors")


def _check_there(key: str, folder: str, file: str, remedy: str = "") -> None:
    if not Path(folder, file).is_file():
        raise BadInput(f"instrument.{key}: {folder}: no {file} there{remedy}")


def _enough(config: Config, key: str, learner: str) -> None:
    count = len(getattr(config.grid, key))
    if count < FEWEST:
        raise BadInput(f"grid.{key}: has {count}; {learner} requires at least {FEWEST}")
