"""The message if ROS 2 is needed and not installed."""

from __future__ import annotations

GET_ROS = (
    "source it, as on a robot, or install its wheels: pip install '.[ros]' in a clone of the "
    'repository (`make setup` does)'
)
