"""Start the command: `python -m pneunet_ros.cli`."""

from __future__ import annotations

import sys

from pneunet_ros.cli.main import main

sys.exit(main())
