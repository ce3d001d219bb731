"""A run's results: its page, and a small folder to keep."""

from click import option

from slipstitch.cli.options import Arguments, config_files, configuration, switch, verb
from slipstitch.cli.parameter_types import FOLDER, PAGE


@verb(
    "write a self-contained HTML report on a results folder",
    "slipstitch report --config results/config.json --results results "
    "--out results/report/index.html",
)
@config_files()
@option("--results", required=True, help="results folder; may be incomplete")
@option("--out", type=PAGE, required=True, help="HTML file")
def report(arguments: Arguments) -> None:
    """Write the page; print its path and the missing stages."""
    from slipstitch.report.page import write_report

    context = write_report(configuration(arguments), arguments.results, arguments.out)
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
    missing = [name for name, made in there.items() if not made]
    size = arguments.out.stat().st_size / 1e6
    print(
        f"{arguments.out}: {size:.1f} MB" + (f"; not run: {', '.join(missing)}" if missing else "")
    )


@verb(
    "copy scores, predictions, curves, costs, the model that ships and provenance of a run",
    "slipstitch publish --config results/config.json --results results "
    "--out-dir results/published/demo",
)
@config_files("YAML or JSON configuration that the results were made with")
@option("--results", default="results", show_default=True, help="folder of the results")
@option(
    "--out-dir",
    type=FOLDER,
    required=True,
    help="folder: new, empty, or published before and then replaced entirely",
)
@switch("--partial", "publish an unfinished run; the index names what it lacks")
@switch(
    "--update", "keep what the folder has and the results no longer have (images deleted since)"
)
def publish(arguments: Arguments) -> None:
    """Write the folder and say what it holds."""
    from slipstitch.report.publishing import publish as publish_results

    config = configuration(arguments)
    index = publish_results(
        config, arguments.results, arguments.out_dir, arguments.partial, arguments.update
    )
    lacking = f", partial: {len(index['missing'])} lacking" if index["partial"] else ""
    print(f"{arguments.out_dir}: {len(index['files'])} files{lacking}")
