"""slipstitch calibrate: the simulator against theory, before anything is simulated."""

import argparse

SUMMARY = "check the simulator against theory with the configured settings"
EXAMPLE = (
    "slipstitch calibrate --config config.yaml --out results/calibrate/calibration.json "
    "--picture results/calibrate/calibration.png"
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--config", required=True, nargs="+", help="YAML or JSON configuration")
    parser.add_argument("--out", required=True, help="JSON file of settings and checks")
    parser.add_argument("--picture", help="PNG or SVG of measured against theory")


def run(arguments: argparse.Namespace) -> None:
    """Run the experiments, write what they verified, print one line a check."""
    from pathlib import Path

    from slipstitch.calibrate.calibration import calibrate_to_file
    from slipstitch.config import load_config
    from slipstitch.errors import BadInput

    if arguments.picture and Path(arguments.picture).suffix not in (".png", ".svg"):
        raise BadInput(f"--picture {arguments.picture}: must end in .png or .svg")
    calibration = calibrate_to_file(
        load_config(*arguments.config), arguments.out, arguments.picture
    )
    for check in calibration["checks"]:
        where = " ".join(f"{key}={value:.6g}" for key, value in check["options"].items())
        unit = "" if check["relative"] or not check["unit"] else f" {check['unit']}"
        print(
            f"{check['name']:<28} {where:<44} error {check['error']:.2e}{unit}, "
            f"allowed {check['demand']:.2e}{unit}"
        )
    print(f"{len(calibration['checks'])} checks met")
