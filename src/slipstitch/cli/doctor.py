"""slipstitch doctor: uses only the standard library, as packages may be missing."""

import argparse

from slipstitch.report.machine_checks import Standing, examine

SUMMARY = "check the installation and how to complete it; estimate the cost of a configuration"
EXAMPLE = "slipstitch doctor --estimate config.yaml config/paper.yaml"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--estimate",
        nargs="+",
        metavar="FILE",
        help="instead of checking the machine, print jobs, CPU time and disk space of the whole "
        "chain for configuration files merged in this order",
    )


def run(arguments: argparse.Namespace) -> int:
    """Print the findings; return 1 if a requirement is missing."""
    if arguments.estimate:
        from slipstitch.config import load_config
        from slipstitch.design.cost import estimate_table

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
    missing = [finding.name for finding in findings if finding.state is Standing.MISSING]
    print()
    if missing:
        print(f"Slipstitch cannot run everything; missing: {', '.join(missing)} (see above).")
    else:
        print("All requirements of Slipstitch are met.")
    return 1 if missing else 0
