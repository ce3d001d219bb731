"""The installation, a workflow folder, the state of a run, the configuration's schema and ids."""

import click
from click import argument, option

from slipstitch.cli.options import Arguments, config_files, configuration, several, verb
from slipstitch.cli.parameter_types import FOLDER, PARQUET


@verb(
    "check the installation and how to complete it; estimate the cost of a configuration",
    "slipstitch doctor --estimate config.yaml config/paper.yaml",
)
@several(
    "--estimate",
    metavar="FILE",
    help="instead of checking the machine, print jobs, CPU time and disk space of the whole "
    "chain for configuration files merged in this order",
)
def doctor(arguments: Arguments) -> int:
    """Print the findings; return 1 if a requirement is missing."""
    if arguments.estimate:
        from slipstitch.config import load_config
        from slipstitch.design.cost import estimate_table

        print(estimate_table(load_config(*arguments.estimate)))
        return 0
    from slipstitch.report.machine_checks import print_findings

    return print_findings()


@verb(
    "create a workflow folder: Snakefile, rules, configurations, cases",
    "slipstitch init friction && cd friction && snakemake --cores 2 all",
)
@argument("folder", type=FOLDER, help="may exist")
def init(arguments: Arguments) -> None:
    """Copy the workflow's files and say what to do with them."""
    from slipstitch.base.project import lay_out

    lay_out(arguments.folder)
    print(f"{arguments.folder}: config.yaml is the demo; to run it there: snakemake --cores 2 all")


@verb(
    "show the state of a run: failures in plain words, jobs done by stage",
    "slipstitch status --results results",
)
@option("--results", default="results", show_default=True, help="results folder")
@several("--config", hidden=True, help="not needed any more")
@option(
    "--lines",
    type=click.IntRange(0),
    default=12,
    show_default=True,
    help="lines of a failed job's log to show",
)
def status(arguments: Arguments) -> int:
    """Print; return 1 if the last run failed or was interrupted, else 0."""
    from pathlib import Path

    from slipstitch.base.errors import BadInput
    from slipstitch.report.status import status as state_of

    folder = Path(arguments.results)
    if not folder.is_dir():
        raise BadInput(f"{folder}: no such folder; give the results folder of the snakemake run")
    text, stopped = state_of(folder, arguments.lines)
    print(text)
    return 1 if stopped else 0


@verb(
    "write the table of ids and seeds",
    "slipstitch grid --config results/config.json --out results/grid.parquet",
    hidden=True,
)
@config_files()
@option("--out", type=PARQUET, required=True, help="Parquet file")
def grid(arguments: Arguments) -> None:
    """Write the table."""
    from slipstitch.design.grid import write_grid

    write_grid(configuration(arguments), arguments.out)


@verb(
    "print the JSON schema of the configuration",
    "slipstitch schema > workflow/schemas/config.schema.json",
    hidden=True,
)
def schema(arguments: Arguments) -> None:
    """Print it."""
    from slipstitch.config.model import schema_text

    print(schema_text(), end="")
