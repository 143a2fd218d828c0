#!/usr/bin/env bash
# Let every command of the container find ROS and the package.
set -e
source /opt/ros/jazzy/setup.bash
source /workspace/install/setup.bash
exec "$@"
