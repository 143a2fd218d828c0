"""Start the node: `python -m pneunet_ros.nodes.virtual_arm`."""

from __future__ import annotations

import sys

from pneunet_ros.nodes.virtual_arm.node import main

sys.exit(main())
