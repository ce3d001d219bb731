"""Write-up: ``python benchmarks/measured_data --data data/measured --out docs``.

Everything that the page says is computed here from the two published data sets.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from slipstitch.threads import use_one_thread

use_one_thread()


def main() -> int:
    """Write criticism_measured.md, its pictures and the numbers as JSON."""
    from paper_case import write_paper_case
    from write_up import write_up

    from slipstitch.errors import SlipstitchError

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("data/measured"))
    parser.add_argument("--out", type=Path, default=Path("docs"))
    parser.add_argument(
        "--case", type=Path, help="only write the paper traces as a spring-slider case there"
    )
    arguments = parser.parse_args()
    try:
        if arguments.case:
            write_paper_case(arguments.data / "paper_on_paper_stick_slip", arguments.case)
            return 0
        numbers = write_up(arguments.data, arguments.out)
    except SlipstitchError as error:
        print(f"criticise-measured: error: {error}", file=sys.stderr)
        return 2
    print(json.dumps(numbers["verdicts"], indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
