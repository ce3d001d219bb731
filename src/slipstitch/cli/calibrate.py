"""slipstitch calibrate: compare the simulator with theory before any simulation."""

import argparse
from collections.abc import Mapping

from slipstitch.cli.options import add_config, output_json, output_picture, refuse

SUMMARY = "choose numerical settings with a pushed strip, and check them against theory"
EXAMPLE = (
    "slipstitch calibrate --config config.yaml --out results/calibrate/calibration.json "
    "--picture results/calibrate/calibration.png"
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_config(parser, required=False)
    parser.add_argument(
        "--out",
        type=output_json,
        help="JSON file with settings and checks (with --sweep: its runs)",
    )
    parser.add_argument(
        "--draw", metavar="FILE", help="instead: only draw the plots of this calibration"
    )
    parser.add_argument(
        "--sweep",
        metavar="KEY",
        help="only sweep one key: base, time_step_s, vertices, "
        "friction_tolerance, newton_iterations_max or damping_s",
    )
    parser.add_argument("--sweeps", nargs="+", help="files written by --sweep; run now if omitted")
    parser.add_argument(
        "--picture", type=output_picture, help="PNG or SVG: the checks, measurements against theory"
    )
    parser.add_argument(
        "--strip-picture",
        type=output_picture,
        help="PNG or SVG: slip strain, and shapes of the strip",
    )
    parser.add_argument(
        "--settings-picture", type=output_picture, help="PNG or SVG: errors by numerical setting"
    )
    parser.add_argument(
        "--only-failures",
        action="store_true",
        help="draw only if a requirement is not met, as NAME.failed.png",
    )


def run(arguments: argparse.Namespace) -> None:
    """Sweep, choose and check; print one line per setting and per check."""
    from slipstitch.base.errors import BadInput
    from slipstitch.config import load_config
    from slipstitch.config.calibrate import BASE, KEYS
    from slipstitch.physics.calibration.calibration import calibrate_to_file
    from slipstitch.physics.calibration.sweep import sweep_to_file

    pictures = _pictures(arguments)
    if arguments.draw:
        refuse(arguments, ("config", "out", "sweep", "sweeps", "only_failures"), "--draw")
        if not pictures:
            raise BadInput("--draw requires --picture, --strip-picture or --settings-picture")
        from slipstitch.physics.calibration.pictures import draw_again

        draw_again(arguments.draw, pictures)
        return
    if not arguments.config or not arguments.out:
        raise BadInput("--config and --out are required, or --draw")
    if arguments.only_failures and not pictures:
        raise BadInput("--only-failures requires a picture to draw")
    config = load_config(*arguments.config)
    if arguments.sweep is not None:
        if arguments.sweep not in (BASE, *KEYS):
            raise BadInput(f"--sweep {arguments.sweep}: must be one of {', '.join((BASE, *KEYS))}")
        drawing = ("picture", "strip_picture", "settings_picture", "only_failures")
        refuse(arguments, ("sweeps", *drawing), "--sweep")
        sweep_to_file(config, arguments.sweep, arguments.out)
        return

    def draw(calibration: Mapping, record: Mapping, failed: bool) -> None:
        if pictures and (failed or not arguments.only_failures):
            from slipstitch.physics.calibration.pictures import draw_pictures

            draw_pictures(pictures, calibration, record, failed)

    calibration = calibrate_to_file(config, arguments.out, arguments.sweeps, draw)
    for trial in calibration["strip"]["trials"]:
        print(_trial_line(trial, calibration["strip"]["chosen"]))
    for check in calibration["checks"]:
        where = " ".join(f"{key}={value:.6g}" for key, value in check["options"].items())
        unit = "" if check["relative"] or not check["unit"] else f" {check['unit']}"
        print(
            f"{check['name']:<28} {where:<44} error {check['error']:.2e}{unit}, "
            f"allowed {check['demand']:.2e}{unit}"
        )
    print(f"{len(calibration['checks'])} checks met")


def _pictures(arguments: argparse.Namespace) -> dict[str, str]:
    given = {
        "checks": arguments.picture,
        "strip": arguments.strip_picture,
        "settings": arguments.settings_picture,
    }
    return {name: path for name, path in given.items() if path}


def _trial_line(trial: dict, chosen: dict) -> str:
    from slipstitch.physics.calibration.choice import describe

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
