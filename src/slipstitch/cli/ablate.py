"""slipstitch ablate: one question with one seed, or the summary of all results."""

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
    "--question diversity --seed 0 --out results/ablate/diversity/seed0.json\n  "
    "slipstitch ablate --config results/config.json --summary results/ablate "
    "--out results/ablate/ablate.json --page results/ablate/index.html"
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    from slipstitch.config.ablate import QUESTIONS

    add_config(parser)
    parser.add_argument(
        "--out", type=output_json, required=True, help="the result, or the summary (JSON)"
    )
    single = parser.add_argument_group("one question, one seed")
    single.add_argument("--dataset", help="folder written by `slipstitch sample`")
    single.add_argument("--question", choices=QUESTIONS)
    single.add_argument("--seed", type=int)
    add_threads(single)
    every = parser.add_argument_group("summary of all results")
    every.add_argument(
        "--summary", metavar="FOLDER", help="folder of the results: {question}/seed{seed}.json"
    )
    every.add_argument("--page", type=output_page, help="conclusions, plots and tables (HTML)")


def run(arguments: argparse.Namespace) -> None:
    """Answer one question or summarise all results; print the outcome."""
    from slipstitch.base.errors import BadInput
    from slipstitch.config import load_config

    check_at_least(arguments, threads=1, seed=0)
    one = ("dataset", "question", "seed")
    config = load_config(*arguments.config)
    if arguments.summary:
        refuse(arguments, one, "--summary")
        _summary(config, arguments)
        return
    if any(getattr(arguments, name) is None for name in one) or arguments.page:
        raise BadInput(
            "--dataset, --question and --seed are required, or --summary (--page requires "
            "--summary)"
        )
    from slipstitch.learning.ablation.answering import write_answer

    found = write_answer(
        config,
        arguments.dataset,
        arguments.question,
        arguments.seed,
        arguments.out,
        arguments.threads,
    )
    if found["left_out"]:
        print(f"left out: {found['left_out']}")
    for trained in found["variants"]:
        ending = trained["failure"] or "learnt"
        if trained["stayed_at_chance"]:
            ending = "stayed at chance"
        print(
            f"{found['question']} seed {found['seed']}: {trained['network']} {trained['variant']}: "
            f"{trained['training_videos']} videos of {trained['training_simulations']} "
            f"simulations, {trained['passes']:g} passes: {ending}"
        )


def _summary(config, arguments: argparse.Namespace) -> None:
    """Write summary and page; print the sentences."""
    from slipstitch.learning.ablation.collection import write_summary

    summary = write_summary(config, arguments.summary, arguments.out, arguments.page)
    for name, question in summary["questions"].items():
        if question["left_out"]:
            print(f"left out: {question['left_out']}")
        for found in question["comparisons"]:
            print(f"{name}: {found['sentence']}")
