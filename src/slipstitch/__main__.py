"""``python -m slipstitch`` is ``slipstitch``."""

import sys

from slipstitch.cli.main import main

sys.exit(main())
