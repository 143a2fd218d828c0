"""Start the node: `python -m pneunet_ros.nodes.tracker`."""

from __future__ import annotations

import sys

from pneunet_ros.nodes.tracker.node import main

sys.exit(main())
