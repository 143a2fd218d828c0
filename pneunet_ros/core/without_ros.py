"""The message if ROS 2 is needed but not installed."""

from __future__ import annotations

GET_ROS = (
    "source ROS 2, or install its wheels with pip install '.[ros]' in a clone of the repository "
    '(as `make setup` does)'
)
