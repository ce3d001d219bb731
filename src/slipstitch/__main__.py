"""``python -m slipstitch`` is ``slipstitch``."""

import sys

from slipstitch.command import main

sys.exit(main())
