"""The installation, a workflow folder, the state and the results of a run, the configuration."""

from pathlib import Path

import click
from click import argument, option

from slipstitch.cli import options


@options.verb("slipstitch doctor --estimate config.yaml config/paper.yaml")
@options.several(
    "--estimate", metavar="FILE", help="instead: jobs, CPU time and disk of these configurations"
)
def doctor(arguments: options.Arguments) -> int:
    """Check the installation and how to complete it; estimate the cost of a configuration.

    Exit code 1 if a requirement is missing.
    """
    if arguments.estimate:
        from slipstitch.config import load_config
        from slipstitch.design.cost import estimate_table

        print(estimate_table(load_config(*arguments.estimate)))
        return 0
    from slipstitch.report.machine_checks import print_findings

    return print_findings()


@options.verb("slipstitch init friction && cd friction && snakemake --cores 2 all")
@argument("folder", type=options.FOLDER, help="may exist")
def init(arguments: options.Arguments) -> None:
    """Create a workflow folder: Snakefile, rules, configurations, cases."""
    from slipstitch.base.project import lay_out

    lay_out(arguments.folder)
    print(f"{arguments.folder}: config.yaml is the demo; to run it there: snakemake --cores 2 all")


@options.verb("slipstitch status --results results")
@option("--results", default="results", show_default=True, help="results folder")
@options.several("--config", hidden=True, help="not needed any more")
@option("--lines", type=click.IntRange(0), default=12, help="lines of a failed job's log: 12")
def status(arguments: options.Arguments) -> int:
    """Show the state of a run: failures in plain words, jobs done by stage.

    Exit code 1 if the last run failed or was interrupted.
    """
    from slipstitch.base.errors import BadInput
    from slipstitch.report.status import status as state_of

    folder = Path(arguments.results)
    if not folder.is_dir():
        raise BadInput(f"{folder}: no such folder; give the results folder of the snakemake run")
    text, stopped = state_of(folder, arguments.lines)
    print(text)
    return 1 if stopped else 0


@options.verb(
    "slipstitch grid --config results/config.json --out results/grid.parquet", hidden=True
)
@options.config_files()
@option("--out", type=options.PARQUET, required=True, help="Parquet file")
def grid(arguments: options.Arguments) -> None:
    """Write the table of ids and seeds."""
    from slipstitch.design.grid import write_grid

    write_grid(options.configuration(arguments), arguments.out)


@options.verb("slipstitch schema > workflow/schemas/config.schema.json", hidden=True)
def schema(arguments: options.Arguments) -> None:
    """Print the JSON schema of the configuration."""
    from slipstitch.config.model import schema_text

    print(schema_text(), end="")


@options.verb(
    "slipstitch report --config results/config.json --results results "
    "--out results/report/index.html"
)
@options.config_files()
@option("--results", required=True, help="results folder; may be incomplete")
@option("--out", type=options.PAGE, required=True, help="HTML file")
def report(arguments: options.Arguments) -> None:
    """Write a self-contained HTML report on a results folder."""
    from slipstitch.report.page import write_report

    context = write_report(options.configuration(arguments), arguments.results, arguments.out)
    there = {
        "calibrate": context["physics"],
        "simulate": context["simulations"]["done"],
        "render": context["rendered"],
        "sample": context["dataset"],
        "train": context["networks"],
        "evaluate": context["test_sets"],
        "criticise": context["criticism"],
        "release": context["audit"],
    }
    missing = ", ".join(name for name, made in there.items() if not made)
    size = arguments.out.stat().st_size / 1e6
    print(f"{arguments.out}: {size:.1f} MB" + (f"; not run: {missing}" if missing else ""))


@options.verb(
    "slipstitch publish --config results/config.json --results results "
    "--out-dir results/published/demo"
)
@options.config_files("YAML or JSON configuration that the results were made with")
@option("--results", default="results", show_default=True, help="folder of the results")
@option("--out-dir", type=options.FOLDER, required=True, help="new, empty, or published before")
@options.switch("--partial", "publish an unfinished run; the index names what it lacks")
@options.switch("--update", "keep what the folder has and the results no longer have")
def publish(arguments: options.Arguments) -> None:
    """Copy scores, predictions, curves, costs, the model that ships and provenance of a run."""
    from slipstitch.report.publishing import publish as publish_results

    folders = arguments.results, arguments.out_dir
    how = arguments.partial, arguments.update
    index = publish_results(options.configuration(arguments), *folders, *how)
    lacking = f", partial: {len(index['missing'])} lacking" if index["partial"] else ""
    print(f"{arguments.out_dir}: {len(index['files'])} files{lacking}")
