"""What to say where ROS 2 is needed and is not there."""

from __future__ import annotations

GET_ROS = (
    "source it, as on a robot, or install its wheels: pip install '.[ros]' in a clone of the "
    'repository (`make setup` does)'
)
