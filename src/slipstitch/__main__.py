"""``python -m slipstitch`` is ``slipstitch``; before installation it says what is missing."""

import importlib.util
import sys

if importlib.util.find_spec("click") is None:
    from slipstitch.report.machine_checks import print_findings

    sys.exit(print_findings())

from slipstitch.cli.main import main

sys.exit(main())
