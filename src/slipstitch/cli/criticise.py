"""Measured data: what the model gets wrong in them, and predictions of a new case."""

import sys
from pathlib import Path

import click
from click import argument, option

from slipstitch.cli import options


@options.verb("slipstitch criticise cases/linen-on-glass --out verdict.json --report verdict.html")
@argument("case", metavar="CASE_DIR", help="folder of one case (docs/criticise-your-data.md)")
@option("--out", type=options.JSON, required=True, metavar="FILE", help="verdict as JSON")
@option("--report", type=options.Output(".html", ".md"), help="the verdict as a page, or Markdown")
@option("--picture", type=options.Output(".svg"), help="plot of the residuals, as SVG")
@option("--model", type=options.Output(".yaml", ".yml"), help="the extended model as YAML")
@option(
    "--resimulate",
    type=options.JSON,
    help="simulate the drop-and-drag runs with the null and the extended law (a second per run), "
    "each with models found without its specimen: errors and gain",
)
@option(
    "--validate",
    metavar="NEW_CASE",
    help="predict a fresh case, lock the prediction (OUT.prediction.csv) and score it with the "
    "measured values, if there are any (OUT.validation.json)",
)
@option("--seed", type=click.IntRange(0), default=1, help="of the simulated maxima (default: 1)")
@options.switch("--power", "before the measurement: smallest detectable effects of the run tables")
@option("--replicates", type=click.IntRange(50), default=300, help="data sets a p (default: 300)")
@option(
    "--campaigns",
    type=click.IntRange(0),
    default=0,
    help="simulate the rate of false alarms with so many campaigns (default: state its limit)",
)
def criticise(arguments: options.Arguments) -> int:
    """Find what the friction model gets wrong in a measured case, and why.

    Exit code 0 whatever the verdict.
    """
    from slipstitch.base.progress import note
    from slipstitch.criticise.case import read_case
    from slipstitch.criticise.criticism_files import criticise_to_files

    chance = arguments.seed, arguments.replicates
    if arguments.power:
        ignored = ("report", "picture", "model", "resimulate", "validate")
        options.refuse(arguments, ignored, "--power")
        from slipstitch.criticise.criticism_files import power_to_file

        case = read_case(arguments.case, with_measurements=False)
        print(power_to_file(case, *chance, arguments.out, arguments.campaigns))
        return 0
    case = read_case(arguments.case)
    note(*case.notes)
    for name in case.ignored_files:
        note(f"{Path(arguments.case) / name}: not a table of any protocol, ignored")
    paths = {
        "verdict": arguments.out,
        "page": arguments.report,
        "picture": arguments.picture,
        "model": arguments.model,
        "resimulation": arguments.resimulate,
    }
    print(criticise_to_files(case, *chance, paths, arguments.campaigns))
    if arguments.validate:
        _validate(arguments.out, Path(arguments.validate))
    return 0


def _validate(out: Path, case: Path) -> None:
    from slipstitch.base.provenance import write_json
    from slipstitch.criticise.case import has_measurements
    from slipstitch.criticise.prediction import lock, read_verdict, score, score_words

    prediction = out.with_suffix(".prediction.csv")
    record = lock(read_verdict(out), case, prediction)
    print(f"{prediction}: locked, sha256 {record['prediction_sha256']}", file=sys.stderr)
    if not has_measurements(case):
        return
    found = score(case, prediction, record)
    write_json(out.with_suffix(".validation.json"), found)
    print(score_words(found))


@options.verb("slipstitch predict verdict.json cases/linen-next-week --out predictions.csv")
@argument("verdict", metavar="VERDICT", help="JSON written by slipstitch criticise")
@argument("case", metavar="CASE_DIR", help="folder of the new case, measured or not")
@option("--out", type=options.TABLE, required=True, metavar="FILE", help="predictions as CSV")
def predict(arguments: options.Arguments) -> None:
    """Predict a new case with the null and the extended model of a verdict."""
    from slipstitch.base.progress import note
    from slipstitch.base.provenance import write_text
    from slipstitch.criticise.case import read_case
    from slipstitch.criticise.prediction import predictions, read_verdict

    verdict = read_verdict(Path(arguments.verdict))
    case = read_case(arguments.case, with_measurements=False)
    note(*case.notes)
    table = predictions(verdict, case)
    write_text(arguments.out, table.to_csv(index=False))
    print(f"{len(table)} predictions written to {arguments.out}")
