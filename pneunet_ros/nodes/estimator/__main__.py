"""Start the node: `python -m pneunet_ros.nodes.estimator`."""

from __future__ import annotations

import sys

from pneunet_ros.nodes.estimator.node import main

sys.exit(main())
