"""``python -m slipstitch`` is ``slipstitch``; before installation it says what is missing."""

import importlib.util
import sys
from pathlib import Path

if importlib.util.find_spec("click") is None:
    from slipstitch.base.errors import BadInput
    from slipstitch.base.project import lay_out
    from slipstitch.report.machine_checks import print_findings

    if len(sys.argv) == 3 and sys.argv[1] == "init":
        try:
            lay_out(Path(sys.argv[2]))
        except BadInput as error:
            print(f"slipstitch init: error: {error}", file=sys.stderr)
            sys.exit(2)
        sys.exit()
    sys.exit(print_findings())

from slipstitch.cli.main import main

sys.exit(main())
