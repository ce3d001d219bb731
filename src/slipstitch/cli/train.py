"""slipstitch train: one network, one split, one seed."""

import argparse

from slipstitch.cli.options import add_training, check_at_least

SUMMARY = "train a network that predicts material or friction from the sampled frames"
EXAMPLE = (
    "slipstitch train --config results/config.json --dataset results/sample "
    "--network friction_baseline --split by_video --seed 0 "
    "--out-dir results/train/by_video/friction_baseline/seed0"
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    from slipstitch.config.train import NETWORKS

    add_training(parser, "folder for the trained model")
    parser.add_argument("--network", required=True, choices=NETWORKS)
    parser.add_argument(
        "--material-model",
        help="folder of the material_baseline of the same split and seed (friction_conditional)",
    )


def run(arguments: argparse.Namespace) -> None:
    """Train, write the model, print a summary."""
    from slipstitch.config import load_config
    from slipstitch.design.grid import classes
    from slipstitch.learning.lrcn_training import train_network
    from slipstitch.learning.trainer import Run

    check_at_least(arguments, threads=1, seed=0)
    config = load_config(*arguments.config)
    card = train_network(
        config.train,
        Run(
            arguments.dataset,
            arguments.split,
            arguments.seed,
            arguments.out_dir,
            frames=config.sample.frames,
            threads=arguments.threads,
        ),
        arguments.network,
        config.view_order,
        material_model=arguments.material_model,
        expected_classes=classes(config.grid),
    )
    print(
        f"{card['network']} {card['split']} seed {card['seed']}: {card['epochs']} epochs on "
        f"{card['training_videos']} videos of {card['training_simulations']} simulations, "
        f"loss {card['train_loss']:.4f} (chance {card['chance_loss']:.4f})"
    )
