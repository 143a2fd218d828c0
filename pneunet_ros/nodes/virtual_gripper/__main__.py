"""Start the node: `python -m pneunet_ros.nodes.virtual_gripper`."""

from __future__ import annotations

import sys

from pneunet_ros.nodes.start import start


def main() -> int:
    """Run the virtual arms and their object until a signal comes; returns the exit code."""
    return start('virtual_gripper')


if __name__ == '__main__':
    sys.exit(main())
