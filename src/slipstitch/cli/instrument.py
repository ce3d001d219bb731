"""slipstitch instrument: train, average and calibrate the measuring instrument."""

import argparse
from typing import Any

from slipstitch.cli.options import add_training, check_at_least, refuse, require

SUMMARY = "train, average and calibrate the measuring instrument for friction and its alarm"
EXAMPLE = (
    "slipstitch instrument --config results/config.json --dataset results/sample "
    "--split by_simulation --seed 0 --out-dir results/instrument/by_simulation/seed0"
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    what = parser.add_mutually_exclusive_group(required=True)
    add_training(parser, "folder for the instrument", what)
    what.add_argument(
        "--members",
        nargs="+",
        metavar="DIR",
        help="average these instruments, trained with other seeds, and calibrate the average",
    )
    what.add_argument(
        "--recalibrate",
        metavar="DIR",
        help="stretch the intervals of this average by --calibration-datasets or --readings too",
    )
    parser.add_argument(
        "--calibration-datasets",
        nargs="+",
        action="extend",
        default=[],
        metavar="DIR",
        help="with --members or --recalibrate: datasets of which all videos calibrate too",
    )
    parser.add_argument(
        "--readings",
        nargs="+",
        action="extend",
        default=[],
        metavar="FILE",
        help="with --recalibrate: JSON files of its readings of videos of known friction",
    )


def run(arguments: argparse.Namespace) -> None:
    """Train, average or recalibrate, write, print a summary."""
    check_at_least(arguments, threads=1, seed=0)
    if arguments.recalibrate:
        refuse(arguments, ("config", "dataset", "split"), "--recalibrate")
        from slipstitch.base.errors import BadInput
        from slipstitch.learning.instrument.ensemble import recalibrate_instrument

        if not (arguments.calibration_datasets or arguments.readings):
            raise BadInput("--recalibrate requires --calibration-datasets, --readings or both")
        _print_average(
            recalibrate_instrument(
                arguments.recalibrate,
                arguments.out_dir,
                arguments.calibration_datasets,
                arguments.readings,
                threads=arguments.threads,
            )
        )
        return
    mode = "--members" if arguments.members else "--seed"
    refuse(arguments, ("readings",), mode)
    require(arguments, ("config", "dataset", "split"), mode)
    from slipstitch.config import load_config

    config = load_config(*arguments.config)
    if arguments.members:
        from slipstitch.learning.instrument.ensemble import combine_instruments

        _print_average(
            combine_instruments(
                arguments.members,
                arguments.dataset,
                arguments.split,
                arguments.out_dir,
                arguments.calibration_datasets,
                threads=arguments.threads,
            )
        )
        return
    refuse(arguments, ("calibration_datasets",), mode)
    from slipstitch.learning.instrument.training import train_instrument
    from slipstitch.learning.trainer import Run

    run = Run(
        arguments.dataset,
        arguments.split,
        arguments.seed,
        arguments.out_dir,
        frames=config.sample.frames,
        threads=arguments.threads,
    )
    card = train_instrument(config.instrument, run, config.instrument_views)
    print(
        f"instrument {card['split']} seed {card['seed']}: {card['epochs']} epochs on "
        f"{card['training_videos']} videos of {card['training_simulations']} simulations, "
        f"loss {card['train_loss']:.4f} (chance {card['chance_loss']:.4f}); {_error_bars(card)}"
    )


def _print_average(card: dict[str, Any]) -> None:
    seeds = ", ".join(map(str, card["seeds"]))
    print(f"instrument {card['split']}, average of seeds {seeds}; {_error_bars(card)}")


def _error_bars(card: dict[str, Any]) -> str:
    """On how many simulations they are calibrated, and whether these suffice."""
    bars = card["error_bars"]
    if bars is None:
        return "not calibrated: no simulations available"
    calibrated = f"calibrated on {card['calibration_simulations']} simulations"
    return calibrated + (", too few for an interval" if bars["factor"] is None else "")
