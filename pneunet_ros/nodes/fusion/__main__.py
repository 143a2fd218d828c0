"""Start the node: `python -m pneunet_ros.nodes.fusion`."""

from __future__ import annotations

import sys

from pneunet_ros.nodes.start import start


def main() -> int:
    """Run the node until a signal comes; returns the exit code."""
    return start('fusion')


if __name__ == '__main__':
    sys.exit(main())
