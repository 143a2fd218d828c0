"""The nodes, and all that knows ROS: message -> core -> message, nothing else."""

from __future__ import annotations

from importlib.util import find_spec

if find_spec('rclpy') is None:
    raise ModuleNotFoundError(
        "no ROS 2 here: source it, or install its wheels by pip install 'pneunet_ros[ros]'"
    )
