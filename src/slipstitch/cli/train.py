"""slipstitch train: one network, one split, one seed."""

import argparse

SUMMARY = "train a network that reads material or friction off the sampled frames"
EXAMPLE = (
    "slipstitch train --config results/config.json --dataset results/sample "
    "--network friction_baseline --split by_video --seed 0 "
    "--out-dir results/train/by_video/friction_baseline/seed0"
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    from slipstitch.cli.options import add_config, add_threads
    from slipstitch.config.train import NETWORKS, SPLITS

    add_config(parser)
    parser.add_argument("--dataset", required=True, help="folder that `slipstitch sample` wrote")
    parser.add_argument("--network", required=True, choices=NETWORKS)
    parser.add_argument("--split", required=True, choices=SPLITS)
    parser.add_argument("--seed", required=True, type=int)
    parser.add_argument("--out-dir", required=True, help="folder of the trained model")
    parser.add_argument(
        "--material-model",
        help="folder of the material_baseline of the same split and seed (friction_conditional)",
    )
    add_threads(parser)


def run(arguments: argparse.Namespace) -> None:
    """Train, write the model, say how it went."""
    from slipstitch.config import load_config
    from slipstitch.errors import BadInput
    from slipstitch.material import fabric_names
    from slipstitch.train.training import train_network

    if arguments.threads < 1 or arguments.seed < 0:
        raise BadInput("--threads must be at least 1, --seed at least 0")
    config = load_config(*arguments.config)
    card = train_network(
        config.train,
        arguments.dataset,
        arguments.network,
        arguments.split,
        arguments.seed,
        arguments.out_dir,
        frames=config.sample.frames,
        view_order=config.view_order,
        material_model=arguments.material_model,
        expected_classes={
            "material": sorted(config.grid.materials, key=fabric_names().index),
            "friction": list(config.grid.frictions),
        },
        threads=arguments.threads,
    )
    print(
        f"{card['network']} {card['split']} seed {card['seed']}: {card['epochs']} epochs on "
        f"{card['training_videos']} videos of {card['training_simulations']} simulations, "
        f"loss {card['train_loss']:.4f} (chance {card['chance_loss']:.4f})"
    )
