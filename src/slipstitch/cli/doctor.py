"""slipstitch doctor: on the standard library alone, as packages may be missing."""

import argparse

from slipstitch.doctor.checks import CheckState, examine

SUMMARY = "what is installed, what is missing and how to get it; what a scale costs"
EXAMPLE = "slipstitch doctor --estimate config.yaml config/paper.yaml"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--estimate",
        nargs="+",
        metavar="FILE",
        help="instead of looking at the machine, print jobs, CPU time and disk of the whole chain "
        "for configuration files merged in this order",
    )


def run(arguments: argparse.Namespace) -> int:
    """Print the findings; 1 if something needed is missing."""
    if arguments.estimate:
        from slipstitch.config import load_config
        from slipstitch.doctor.cost import estimate_table

        print(estimate_table(load_config(*arguments.estimate)))
        return 0
    findings = examine()
    width = max(len(finding.name) for finding in findings)
    for finding in findings:
        print(f"{finding.state.value:<7} {finding.name:<{width}}  {finding.found}")
    remedies = [finding for finding in findings if finding.remedy]
    if remedies:
        print()
        for finding in remedies:
            print(f"{finding.name}: {finding.remedy}")
    missing = [finding.name for finding in findings if finding.state is CheckState.MISSING]
    print()
    if missing:
        print(f"Slipstitch cannot run everything: {', '.join(missing)} (see above).")
    else:
        print("Everything that Slipstitch needs is here.")
    return 1 if missing else 0
