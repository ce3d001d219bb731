"""Networks and instruments: train, evaluate, ablate."""

from typing import Any

import click
from click import option

from slipstitch.base.errors import BadInput
from slipstitch.cli import options

# Names of `slipstitch.config.train`, which is too slow to import for a help text.
SPLIT = click.Choice(("by_video", "by_simulation", "by_video_reflective"))
NETWORK = click.Choice(("material_baseline", "friction_baseline", "friction_conditional"))
QUESTION = click.Choice(("diversity", "conditioning", "schedule", "initialisation", "floors"))
SEED = click.IntRange(0)
DATASET = "folder written by `slipstitch sample`"


@options.verb(
    "slipstitch train --config results/config.json --dataset results/sample "
    "--network friction_baseline --split by_video --seed 0 "
    "--out-dir results/train/by_video/friction_baseline/seed0"
)
@options.config_files()
@option("--dataset", required=True, help=DATASET)
@option("--split", required=True, type=SPLIT)
@option("--seed", required=True, type=SEED)
@option("--out-dir", type=options.FOLDER, required=True, help="folder for the trained model")
@options.thread_count()
@option("--network", required=True, type=NETWORK)
@option("--material-model", help="friction_conditional: folder of the material_baseline")
def train(arguments: options.Arguments) -> None:
    """Train a network that predicts material or friction from the sampled frames."""
    from slipstitch.design.grid import classes
    from slipstitch.design.trainable import view_order
    from slipstitch.learning.lrcn_training import train_network

    config = options.configuration(arguments)
    card = train_network(
        config.train, _run(arguments, config), arguments.network, view_order(config),
        material_model=arguments.material_model, expected_classes=classes(config.grid),
    )  # fmt: skip
    print(
        f"{card['network']} {card['split']} seed {card['seed']}: {card['epochs']} epochs on "
        f"{card['training_videos']} videos of {card['training_simulations']} simulations, "
        f"loss {card['train_loss']:.4f} (chance {card['chance_loss']:.4f})"
    )


def _run(arguments: options.Arguments, config):
    """What one training is given."""
    from slipstitch.learning.trainer import Run

    return Run(
        arguments.dataset,
        arguments.split,
        arguments.seed,
        arguments.out_dir,
        frames=config.sample.frames,
        threads=arguments.threads,
    )


@options.verb(
    "slipstitch instrument --config results/config.json --dataset results/sample "
    "--split by_simulation --seed 0 --out-dir results/instrument/by_simulation/seed0"
)
@options.config_files(required=False)
@option("--dataset", help=DATASET)
@option("--split", type=SPLIT)
@option("--out-dir", type=options.FOLDER, required=True, help="folder for the instrument")
@options.thread_count()
@option("--seed", type=SEED, help="train an instrument with this seed")
@options.several("--members", metavar="DIR", help="instead: average and calibrate these")
@option("--recalibrate", metavar="DIR", help="instead: calibrate the intervals of this average")
@options.several(
    "--calibration-datasets", metavar="DIR", help="of an average: all their videos calibrate too"
)
@options.several(
    "--readings", metavar="FILE", help="with --recalibrate: its readings of known videos (JSON)"
)
def instrument(arguments: options.Arguments) -> None:
    """Train, average and calibrate the measuring instrument for friction and its alarm."""
    mode = options.exactly_one(arguments, "seed", "members", "recalibrate")
    datasets = list(arguments.calibration_datasets)
    if mode == "recalibrate":
        options.refuse(arguments, ("config", "dataset", "split"), options.flag(mode))
        from slipstitch.learning.instrument.ensemble import recalibrate_instrument

        if not (arguments.calibration_datasets or arguments.readings):
            raise BadInput("--recalibrate requires --calibration-datasets, --readings or both")
        card = recalibrate_instrument(
            arguments.recalibrate,
            arguments.out_dir,
            datasets,
            list(arguments.readings),
            arguments.threads,
        )
        _print_average(card)
        return
    options.refuse(arguments, ("readings",), options.flag(mode))
    options.require(arguments, ("config", "dataset", "split"), options.flag(mode))

    config = options.configuration(arguments)
    if mode == "members":
        from slipstitch.learning.instrument.ensemble import combine_instruments

        card = combine_instruments(
            list(arguments.members),
            arguments.dataset,
            arguments.split,
            arguments.out_dir,
            datasets,
            threads=arguments.threads,
        )
        _print_average(card)
        return
    options.refuse(arguments, ("calibration_datasets",), options.flag(mode))
    from slipstitch.design.trainable import instrument_views
    from slipstitch.learning.instrument.training import train_instrument

    run = _run(arguments, config)
    card = train_instrument(config.instrument, run, instrument_views(config))
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


@options.verb(
    "slipstitch evaluate --config results/config.json --dataset results/sample "
    "--models results/train --out results/evaluate/metrics.json "
    "--predictions results/evaluate/predictions.parquet"
)
@options.config_files()
@option("--dataset", required=True, help=DATASET)
@option("--models", help="folder {split}/{network}/seed{seed}/")
@option("--instruments", help="folder {split}/seed{seed}/ of instruments")
@option("--out", type=options.JSON, required=True, help="metrics.json")
@option("--predictions", type=options.PARQUET, required=True, help="predictions.parquet")
@option("--details", type=options.JSON, help="by seed and view (default: details.json beside)")
@options.switch("--update", "keep the scores of models that are unchanged since --out was written")
@options.thread_count()
@options.switch("--captures", "the dataset is of captures, from `slipstitch capture ingest`")
@option("--page", type=options.PAGE, help="with --captures: tables and plots (HTML)")
def evaluate(arguments: options.Arguments) -> None:
    """Evaluate the trained networks: metrics, confusion, predictions."""
    from slipstitch.film.measure.measuring_bench import shipped_for
    from slipstitch.learning.evaluation.evaluation import write_evaluation
    from slipstitch.learning.evaluation.metrics import test_set_lines
    from slipstitch.learning.evaluation.trained import Trained

    config = options.configuration(arguments)
    if not (arguments.models or arguments.instruments):
        raise BadInput("--models, --instruments or both are required")
    trained = Trained(config, arguments.models, arguments.instruments, shipped_for(config))
    if arguments.captures:
        _captures(arguments, trained)
        return
    if arguments.page:
        raise BadInput("--page requires --captures")
    details = arguments.details or arguments.out.with_name("details.json")
    metrics = write_evaluation(
        arguments.dataset,
        trained,
        (arguments.out, arguments.predictions, details),
        update=arguments.update,
        threads=arguments.threads,
    )
    print(*test_set_lines(metrics), sep="\n")


def _captures(arguments: options.Arguments, trained) -> None:
    """Evaluate on captures; print one line per model and subset."""
    from slipstitch.film.captures_evaluation import write_captures_evaluation
    from slipstitch.learning.evaluation.metrics import capture_lines

    options.refuse(arguments, ("details", "update"), "--captures")
    metrics = write_captures_evaluation(
        arguments.dataset,
        trained,
        arguments.out,
        arguments.predictions,
        arguments.page,
        threads=arguments.threads,
    )
    print(*capture_lines(metrics), sep="\n")


@options.verb(
    "slipstitch ablate --config results/config.json --dataset results/sample "
    "--question diversity --network lrcn --variant textures --seed 0 "
    "--out results/ablate/diversity/lrcn_textures_seed0.json\n  "
    "slipstitch ablate --config results/config.json --summary results/ablate "
    "--out results/ablate/ablate.json --page results/ablate/index.html"
)
@options.config_files()
@option("--out", type=options.JSON, required=True, help="the result, or the summary (JSON)")
@option("--dataset", help=DATASET)
@option("--question", type=QUESTION, help="train and test one variant of a question")
@option("--network", type=click.Choice(("lrcn", "instrument")))
@option("--variant", metavar="NAME", help="one of the question's variants of the network")
@option("--seed", type=SEED)
@options.thread_count()
@option("--summary", metavar="FOLDER", help="instead: sum up the results in a folder")
@option("--page", type=options.PAGE, help="with --summary: conclusions, plots and tables (HTML)")
def ablate(arguments: options.Arguments) -> None:
    """Ablations: change one training choice at a time, at an equal budget."""
    one = ("dataset", "question", "network", "variant", "seed")
    config = options.configuration(arguments)
    if arguments.summary:
        options.refuse(arguments, one, "--summary")
        _summary(config, arguments)
        return
    if any(getattr(arguments, name) is None for name in one) or arguments.page:
        raise BadInput(
            "--dataset, --question, --network, --variant and --seed are required, or --summary "
            "(--page requires --summary)"
        )
    from slipstitch.config.train import VARIANTS
    from slipstitch.learning.ablation.run import Case, write_case

    variants = VARIANTS[arguments.question].get(arguments.network, ())
    if arguments.variant not in variants:
        raise BadInput(
            f"{arguments.question} has no variant {arguments.network} {arguments.variant}; "
            f"its variants: {', '.join(variants) or 'none'}"
        )
    case = Case(arguments.question, arguments.network, arguments.variant, arguments.seed)
    found = write_case(config, arguments.dataset, case, arguments.out, arguments.threads)
    if found["left_out"]:
        print(f"left out: {found['left_out']}")
        return
    ending = "stayed at chance" if found["stayed_at_chance"] else found["failure"] or "learnt"
    print(
        f"{case.question} seed {case.seed}: {case.network} {case.variant}: "
        f"{found['training_videos']} videos of {found['training_simulations']} "
        f"simulations, {found['passes']:g} passes: {ending}"
    )


def _summary(config, arguments: options.Arguments) -> None:
    """Write summary and page; print the sentences."""
    from slipstitch.learning.ablation.summary import write_summary

    summary = write_summary(config, arguments.summary, arguments.out, arguments.page)
    for name, question in summary["questions"].items():
        if question["left_out"]:
            print(f"left out: {question['left_out']}")
        for found in question["comparisons"]:
            print(f"{name}: {found['sentence']}")
