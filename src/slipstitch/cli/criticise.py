"""slipstitch criticise: find what the model gets wrong in measured data, and why."""

import argparse
import sys
from pathlib import Path

from slipstitch.cli.options import check_at_least, output_json, output_named, refuse

SUMMARY = "find what the friction model gets wrong in a measured case, and why"
EXAMPLE = "slipstitch criticise cases/linen-on-glass --out verdict.json --report verdict.html"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.add_argument(
        "case", metavar="CASE_DIR", help="folder of one case (docs/criticise-your-data.md)"
    )
    parser.add_argument(
        "--out", type=output_json, required=True, metavar="FILE", help="verdict as JSON"
    )
    parser.add_argument(
        "--report",
        type=output_named(".html", ".md"),
        metavar="FILE",
        help="the verdict as an HTML page, or as Markdown without pictures",
    )
    parser.add_argument(
        "--picture", type=output_named(".svg"), metavar="FILE", help="plot of the residuals, as SVG"
    )
    parser.add_argument(
        "--model",
        type=output_named(".yaml", ".yml"),
        metavar="FILE",
        help="the extended model as YAML",
    )
    parser.add_argument(
        "--resimulate",
        type=output_json,
        metavar="FILE",
        help="simulate the drop-and-drag runs with the null and the extended law in the cloth "
        "simulator (about a second per run), each with models found without its specimen; errors "
        "and gain as JSON, and on the page",
    )
    parser.add_argument(
        "--validate",
        metavar="NEW_CASE",
        help="predict a fresh case, lock the prediction (OUT.prediction.csv, with a digest) and "
        "score it with the measured values (OUT.validation.json); a prediction locked earlier is "
        "kept, and a case without measured values is only predicted",
    )
    parser.add_argument(
        "--seed", type=int, default=1, help="seed of the simulated maxima (default 1)"
    )
    parser.add_argument(
        "--power",
        action="store_true",
        help="power analysis of a design before the measurement: only run tables are read; --out "
        "contains the smallest detectable effect of every mechanism",
    )
    parser.add_argument(
        "--replicates",
        type=int,
        default=300,
        help="simulated data sets for each family-wise p (default 300)",
    )
    parser.add_argument(
        "--campaigns",
        type=int,
        default=0,
        help="simulate the rate of false alarms with as many campaigns of this design, noise and "
        "scatter that hold nothing (each as long as the criticism itself; default 0: only the "
        "limit is stated)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Criticise one case, or what its design could show; exit code 0 whatever the verdict."""
    from slipstitch.base.progress import note
    from slipstitch.criticise.case import read_case
    from slipstitch.criticise.criticism_files import criticise_to_files

    check_at_least(arguments, seed=0, replicates=50, campaigns=0)
    if arguments.power:
        ignored = ("report", "picture", "model", "resimulate", "validate")
        refuse(arguments, ignored, "--power")
        from slipstitch.criticise.criticism_files import power_to_file

        case = read_case(arguments.case, with_measurements=False)
        seed, replicates = arguments.seed, arguments.replicates
        print(power_to_file(case, seed, replicates, arguments.out, arguments.campaigns))
        return 0
    case = read_case(arguments.case)
    note(*case.notes)
    for name in case.ignored_files:
        print(
            f"{Path(arguments.case) / name}: not a table of any protocol, ignored", file=sys.stderr
        )
    line = criticise_to_files(
        case,
        arguments.seed,
        arguments.replicates,
        campaigns=arguments.campaigns,
        verdict_path=arguments.out,
        page_path=arguments.report,
        picture_path=arguments.picture,
        model_path=arguments.model,
        resimulation_path=arguments.resimulate,
    )
    print(line)
    if arguments.validate:
        _validate(Path(arguments.out), Path(arguments.validate))
    return 0


def _validate(out: Path, case: Path) -> None:
    from slipstitch.base.provenance import write_json
    from slipstitch.criticise.case import has_measurements
    from slipstitch.criticise.prediction.predictive import read_verdict
    from slipstitch.criticise.prediction.validation import lock, score, score_words

    prediction = out.with_suffix(".prediction.csv")
    record = lock(read_verdict(out), case, prediction)
    print(f"{prediction}: locked, sha256 {record['prediction_sha256']}", file=sys.stderr)
    if not has_measurements(case):
        return
    found = score(case, prediction, record)
    write_json(out.with_suffix(".validation.json"), found)
    print(score_words(found))
