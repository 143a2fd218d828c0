"""The ROS nodes: message to core to message. Only this room imports ROS."""
