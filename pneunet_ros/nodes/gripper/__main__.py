"""Start the node: `python -m pneunet_ros.nodes.gripper`."""

from __future__ import annotations

import sys

from pneunet_ros.nodes.start import start


def main() -> int:
    """Run the nodes of all arms until a signal comes; returns the exit code."""
    return start('gripper')


if __name__ == '__main__':
    sys.exit(main())
