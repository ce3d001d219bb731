"""slipstitch convergence: the study of time step and mesh, ``run | compare | publish``.

``run`` simulates one case, ``compare`` compares them all, ``publish`` copies a finished study
to the published results, and its summary to the file that simulations read for their metadata.
"""

import argparse
import sys

from slipstitch.cli.options import (
    add_calibration,
    add_config,
    output_folder,
    output_json,
    output_named,
    output_parquet,
)

SUMMARY = "simulate the cases of the convergence study, compare them, publish the results"
EXAMPLE = (
    "slipstitch convergence run --config config.yaml --case m05_f0300_n41_h2 "
    "--out results/convergence/runs/m05_f0300_n41_h2.parquet"
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the subcommands and their options."""
    verbs = parser.add_subparsers(metavar="WHAT", required=True)
    run, compare = verbs.add_parser("run"), verbs.add_parser("compare")
    for verb, action in ((run, _run), (compare, _compare)):
        add_config(verb)
        add_calibration(verb)
        verb.set_defaults(action=action)
    publish = verbs.add_parser("publish")
    publish.add_argument("--study", default="results/convergence/convergence.json")
    publish.add_argument(
        "--out", type=output_folder, default="results/published/convergence", help="folder"
    )
    publish.set_defaults(action=_publish)
    run.add_argument("--case", required=True, help="id of the case, e.g. m05_f0300_n41_h2")
    run.add_argument(
        "--out", type=output_parquet, required=True, help="Parquet file, one row per frame"
    )
    compare.add_argument("--runs", required=True, help="folder with the files of the cases")
    compare.add_argument("--out", type=output_json, required=True, help="JSON file")
    compare.add_argument("--picture", type=output_named(".png"), help="PNG file")


def run(arguments: argparse.Namespace) -> None:
    """Run one case, compare those that were run, or publish the comparison."""
    arguments.action(arguments)


def _run(arguments: argparse.Namespace) -> None:
    from slipstitch.config import load_config
    from slipstitch.physics.convergence.case_run import simulate_case

    config = load_config(*arguments.config, calibration=arguments.calibration)
    run, cpu_s = simulate_case(config, arguments.case, arguments.out, arguments.calibration)
    print(f"{arguments.out}: {cpu_s:.1f} CPU s, {run.metadata['solver']}")


def _compare(arguments: argparse.Namespace) -> None:
    from slipstitch.config import load_config
    from slipstitch.physics.convergence.study_files import compare_cases

    config = load_config(*arguments.config, calibration=arguments.calibration)
    study = compare_cases(config, arguments.runs, arguments.out, arguments.picture)
    if study["missing"]:
        print(f"not run, so not compared: {', '.join(study['missing'])}", file=sys.stderr)
    for row in study["summary"]:
        for kind in ("time_step", "mesh"):
            if row[kind] is not None:
                print(
                    f"{row['material']:<20} friction {row['friction']:<4g} {kind:<10} "
                    f"mean {1e3 * row[kind]['mean_m']:7.3f} mm, "
                    f"at the worst time {1e3 * row[kind]['mean_largest_m']:6.2f} mm, "
                    f"worst vertex {1e3 * row[kind]['worst_m']:7.2f} mm, "
                    f"shifted mean {1e3 * row[kind]['shifted_mean_m']:7.3f} mm, "
                    f"events up to {row[kind]['event_shift_s']:.2f} s apart: {row[kind]['verdict']}"
                )


def _publish(arguments: argparse.Namespace) -> None:
    from slipstitch.physics.convergence.study_files import publish
    from slipstitch.physics.simulation.convergence import MEASURED

    count = publish(arguments.study, arguments.out)
    print(f"{arguments.out}, {MEASURED.name}: {count} cases")
