"""slipstitch ablate: one variant of a question with one seed, or the summary of all results."""

import argparse

from slipstitch.cli.options import (
    add_config,
    add_threads,
    check_at_least,
    output_json,
    output_page,
    refuse,
)

SUMMARY = "ablations: change one training choice at a time, at an equal budget"
EXAMPLE = (
    "slipstitch ablate --config results/config.json --dataset results/sample "
    "--question diversity --network lrcn --variant textures --seed 0 "
    "--out results/ablate/diversity/lrcn_textures_seed0.json\n  "
    "slipstitch ablate --config results/config.json --summary results/ablate "
    "--out results/ablate/ablate.json --page results/ablate/index.html"
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    from slipstitch.config.ablate import QUESTIONS, VARIANTS

    add_config(parser)
    parser.add_argument(
        "--out", type=output_json, required=True, help="the result, or the summary (JSON)"
    )
    single = parser.add_argument_group("one variant of a question, one seed")
    single.add_argument("--dataset", help="folder written by `slipstitch sample`")
    single.add_argument("--question", choices=QUESTIONS)
    single.add_argument("--network", choices=("lrcn", "instrument"))
    variants = {name for networks in VARIANTS.values() for of in networks.values() for name in of}
    single.add_argument("--variant", choices=sorted(variants))
    single.add_argument("--seed", type=int)
    add_threads(single)
    every = parser.add_argument_group("summary of all results")
    every.add_argument(
        "--summary",
        metavar="FOLDER",
        help="folder of the results: {question}/{network}_{variant}_seed{seed}.json",
    )
    every.add_argument("--page", type=output_page, help="conclusions, plots and tables (HTML)")


def run(arguments: argparse.Namespace) -> None:
    """Train and test one variant or summarise all results; print the outcome."""
    from slipstitch.base.errors import BadInput
    from slipstitch.config import load_config

    check_at_least(arguments, threads=1, seed=0)
    one = ("dataset", "question", "network", "variant", "seed")
    config = load_config(*arguments.config)
    if arguments.summary:
        refuse(arguments, one, "--summary")
        _summary(config, arguments)
        return
    if any(getattr(arguments, name) is None for name in one) or arguments.page:
        raise BadInput(
            "--dataset, --question, --network, --variant and --seed are required, or --summary "
            "(--page requires --summary)"
        )
    from slipstitch.config.ablate import VARIANTS
    from slipstitch.learning.ablation.run import Case, write_case

    if arguments.variant not in VARIANTS[arguments.question].get(arguments.network, ()):
        raise BadInput(
            f"{arguments.question} has no variant {arguments.network} {arguments.variant}"
        )
    case = Case(arguments.question, arguments.network, arguments.variant, arguments.seed)
    found = write_case(config, arguments.dataset, case, arguments.out, arguments.threads)
    if found["left_out"]:
        print(f"left out: {found['left_out']}")
        return
    ending = found["failure"] or "learnt"
    if found["stayed_at_chance"]:
        ending = "stayed at chance"
    print(
        f"{case.question} seed {case.seed}: {case.network} {case.variant}: "
        f"{found['training_videos']} videos of {found['training_simulations']} "
        f"simulations, {found['passes']:g} passes: {ending}"
    )


def _summary(config, arguments: argparse.Namespace) -> None:
    """Write summary and page; print the sentences."""
    from slipstitch.learning.ablation.summary import write_summary

    summary = write_summary(config, arguments.summary, arguments.out, arguments.page)
    for name, question in summary["questions"].items():
        if question["left_out"]:
            print(f"left out: {question['left_out']}")
        for found in question["comparisons"]:
            print(f"{name}: {found['sentence']}")
