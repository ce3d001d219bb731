"""slipstitch instrument: train and calibrate the measuring instrument."""

import argparse

from slipstitch.cli.options import add_training, check_at_least

SUMMARY = "train the measuring instrument for friction; calibrate its error bars and its alarm"
EXAMPLE = (
    "slipstitch instrument --config results/config.json --dataset results/sample "
    "--split by_simulation --seed 0 --out-dir results/instrument/by_simulation/seed0"
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_training(parser, "folder for the instrument")


def run(arguments: argparse.Namespace) -> None:
    """Train, calibrate, write, print a summary."""
    from slipstitch.config import load_config
    from slipstitch.instrument.training import train_instrument

    check_at_least(arguments, threads=1, seed=0)
    config = load_config(*arguments.config)
    card = train_instrument(
        config.instrument,
        arguments.dataset,
        arguments.split,
        arguments.seed,
        arguments.out_dir,
        frames=config.sample.frames,
        viewpoints=config.instrument_views,
        threads=arguments.threads,
    )
    bars = card["error_bars"]
    if bars is None:
        error_bars = "not calibrated: no simulations available"
    elif bars["factor"] is None:
        error_bars = (
            f"calibrated on {card['calibration_simulations']} simulations, too few for an interval"
        )
    else:
        error_bars = f"calibrated on {card['calibration_simulations']} simulations"
    print(
        f"instrument {card['split']} seed {card['seed']}: {card['epochs']} epochs on "
        f"{card['training_videos']} videos of {card['training_simulations']} simulations, "
        f"loss {card['train_loss']:.4f} (chance {card['chance_loss']:.4f}); {error_bars}"
    )
