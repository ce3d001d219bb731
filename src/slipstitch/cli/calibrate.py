"""The simulator against theory: calibration, single experiments, the convergence study."""

import json
import re
import sys
from collections.abc import Callable, Mapping

import click
from click import argument, option

from slipstitch.base.errors import BadInput
from slipstitch.cli import options

# `slipstitch.config.simulation.BASE` and `KEYS`
SWEPT = "base time_step_s vertices friction_tolerance newton_iterations_max damping_s"
PICTURES = {"checks": "picture", "strip": "strip_picture", "settings": "settings_picture"}


@options.verb(
    "slipstitch calibrate --config config.yaml --out results/calibrate/calibration.json "
    "--picture results/calibrate/calibration.png"
)
@options.config_files(required=False)
@option("--out", type=options.JSON, help="settings and checks (with --sweep: its runs)")
@option("--draw", metavar="FILE", help="instead: only draw the plots of this calibration")
@option("--sweep", type=click.Choice(SWEPT.split()), help="only sweep one key")
@options.several("--sweeps", help="files written by --sweep; run now if omitted")
@option("--picture", type=options.PICTURE, help="the checks, measurements against theory")
@option("--strip-picture", type=options.PICTURE, help="slip strain, and shapes of the strip")
@option("--settings-picture", type=options.PICTURE, help="errors by numerical setting")
@options.switch("--only-failures", "draw only if a requirement is not met, as NAME.failed.png")
def calibrate(arguments: options.Arguments) -> None:
    """Choose numerical settings with a pushed strip, and check them against theory."""
    from slipstitch.physics.calibration.calibration import calibrate_to_file
    from slipstitch.physics.calibration.sweep import sweep_to_file

    wanted = {name: getattr(arguments, option) for name, option in PICTURES.items()}
    pictures = {name: str(path) for name, path in wanted.items() if path}
    if arguments.draw:
        options.refuse(arguments, ("config", "out", "sweep", "sweeps", "only_failures"), "--draw")
        if not pictures:
            raise BadInput("--draw requires --picture, --strip-picture or --settings-picture")
        from slipstitch.physics.calibration.pictures import draw_again

        draw_again(arguments.draw, pictures)
        return
    if not arguments.config or not arguments.out:
        raise BadInput("--config and --out are required, or --draw")
    if arguments.only_failures and not pictures:
        raise BadInput("--only-failures requires a picture to draw")
    config = options.configuration(arguments)
    if arguments.sweep is not None:
        options.refuse(arguments, ("sweeps", *PICTURES.values(), "only_failures"), "--sweep")
        sweep_to_file(config, arguments.sweep, arguments.out)
        return

    def draw(calibration: Mapping, record: Mapping, failed: bool) -> None:
        if pictures and (failed or not arguments.only_failures):
            from slipstitch.physics.calibration.pictures import draw_pictures

            draw_pictures(pictures, calibration, record, failed)

    sweeps = list(arguments.sweeps) or None
    _print_calibration(calibrate_to_file(config, arguments.out, sweeps, draw))


def _print_calibration(calibration: Mapping) -> None:
    for trial in calibration["strip"]["trials"]:
        print(_trial_line(trial, calibration["strip"]["chosen"]))
    for check in calibration["checks"]:
        where = " ".join(f"{key}={value:.6g}" for key, value in check["options"].items())
        unit = "" if check["relative"] or not check["unit"] else f" {check['unit']}"
        error, demand = (f"{check[key]:.2e}{unit}" for key in ("error", "demand"))
        print(f"{check['name']:<28} {where:<44} error {error}, allowed {demand}")
    print(f"{len(calibration['checks'])} checks met")


def _trial_line(trial: dict, chosen: dict) -> str:
    from slipstitch.physics.calibration.calibration import describe

    error = trial["strain_error"]
    strain = "no slip to compare" if error is None else f"slip strain within {error:.2e}"
    verdict = "meets the requirements" if trial["meets"] else "does not meet the requirements"
    if trial["meets"] and not trial["may_be_chosen"]:
        verdict += ", excluded from the choice"
    if trial["settings"] == chosen["settings"]:
        verdict += ", CHOSEN"
    return (
        f"strip with {describe(trial):<32} {strain}, {trial['wrong_regimes']} of "
        f"{len(trial['runs'])} regimes wrong, {trial['cpu_s']:.1f} CPU s: {verdict}"
    )


NAMES = (
    "incline", "tilt", "flat-drag", "strip-drag", "strip", "landed-strip", "cantilever",
    "lateral-buckling", "capstan",
)  # fmt: skip
# What an experiment takes -> its help.
OPTIONS = {
    "friction": "friction coefficient",
    "slope_deg": "incline: slope in degrees",
    "static_kinetic": "tilt: static coefficient over the kinetic, less 1 (default 0)",
    "gravity_length_m": "strip-drag, landed-strip: (B/w)^(1/3), in m (default 0.02)",
    "gamma": "strip, cantilever: areal density x gravity x length^3 / B",
    "strain": "strip: displacement of the push, relative to its length",
    "width_over_length": "lateral-buckling: width of the strip over its length",
    "wrap_deg": "capstan: contact angle in degrees",
    "vertices": "strip, landed-strip, strip-drag: vertices along it",
}


def _experiment_options(run: Callable) -> Callable:
    for name, help in reversed(OPTIONS.items()):
        run = option(options.flag(name), type=int if name == "vertices" else float, help=help)(run)
    return run


@options.verb("slipstitch protocol incline --friction 0.5 --slope-deg 30 --out incline.json")
@argument("name", metavar="NAME", type=click.Choice(NAMES), help=", ".join(NAMES))
@option("--out", type=options.JSON, required=True, help="measured and theoretical values")
@_experiment_options
@option("--time-step", type=float, metavar="S", help="time step in s")
def protocol(arguments: options.Arguments) -> int:
    """Run a known-answer experiment in the simulator and compare it with theory.

    Exit code 1 if the result does not meet its demands.
    """
    from slipstitch.config.load import resolve_config
    from slipstitch.physics.experiments.registry import run_protocol_to_file

    given = {name: getattr(arguments, name) for name in OPTIONS}
    given = {name: value for name, value in given.items() if value is not None}
    asked = {"time_step_s": arguments.time_step}
    if arguments.name == "strip-drag":  # as many as along a side of the simulated cloth
        asked["vertices_per_side"] = given.pop("vertices", None)
    overrides = {key: value for key, value in asked.items() if value is not None}
    settings = resolve_config({"simulation": overrides}, sources=("command line",)).simulation
    try:
        result = run_protocol_to_file(arguments.name, given, settings, arguments.out)
    except BadInput as error:
        named = re.compile(rf"\b({'|'.join(OPTIONS)})\b")
        raise BadInput(named.sub(lambda m: options.flag(m[0]), str(error))) from None
    # Curves and histories are in the file only.
    numbers = {key: value for key, value in result.items() if not isinstance(value, list)}
    print(json.dumps(numbers, indent=1))
    for key, demand in result["demands"].items():
        print(_demand_line(key, demand), file=sys.stderr)
    return 0 if result["passed"] else 1


def _demand_line(key: str, demand: dict) -> str:
    shown = "passed" if demand["met"] else "FAILED"
    if demand["error"] is None:
        return f"{shown}: {key} is not theory's"
    scale, unit = (100.0, " %") if demand["relative"] else (1.0, "")
    off, allowed = scale * demand["error"], scale * demand["allowed"]
    difference = f"differs from theory by {off:.2g}{unit}, allowed {allowed:g}{unit}"
    return f"{shown}: {key} {difference}"


@click.group(hidden=True)
def convergence() -> None:
    """Simulate the cases of the convergence study, compare them, publish the results."""


@options.verb(
    "slipstitch convergence run --config config.yaml --case m05_f0300_n41_h2 "
    "--out results/convergence/runs/m05_f0300_n41_h2.parquet",
    parent=convergence,
)
@options.config_files()
@options.calibration_file
@option("--case", required=True, help="id of the case, e.g. m05_f0300_n41_h2")
@option("--out", type=options.PARQUET, required=True, help="Parquet file, one row per frame")
def run(arguments: options.Arguments) -> None:
    """Simulate one case."""
    from slipstitch.physics.convergence.cases import simulate_case

    config = options.configuration(arguments, calibration=arguments.calibration)
    solver, cpu_s = simulate_case(config, arguments.case, arguments.out, arguments.calibration)
    print(f"{arguments.out}: {cpu_s:.1f} CPU s, {solver}")


@options.verb(
    "slipstitch convergence compare --config config.yaml --runs results/convergence/runs "
    "--out results/convergence/convergence.json",
    parent=convergence,
)
@options.config_files()
@options.calibration_file
@option("--runs", required=True, help="folder with the files of the cases")
@option("--out", type=options.JSON, required=True, help="JSON file")
@option("--picture", type=options.Output(".png"), help="PNG file")
def compare(arguments: options.Arguments) -> None:
    """Compare the cases that were run."""
    from slipstitch.physics.convergence.study_files import compare_cases

    config = options.configuration(arguments, calibration=arguments.calibration)
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


@options.verb(
    "slipstitch convergence publish --study results/convergence/convergence.json",
    parent=convergence,
)
@option("--study", default="results/convergence/convergence.json", show_default=True)
@option("--out", type=options.FOLDER, default="results/published/convergence", help="folder")
def publish(arguments: options.Arguments) -> None:
    """Copy a finished study to the published results and its summary to the package."""
    from slipstitch.physics.convergence.study_files import publish as publish_study
    from slipstitch.physics.simulation.convergence import MEASURED

    count = publish_study(arguments.study, arguments.out)
    print(f"{arguments.out}, {MEASURED.name}: {count} cases")
