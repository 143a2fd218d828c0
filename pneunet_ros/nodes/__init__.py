"""The ROS nodes. Only this package imports ROS."""
