"""ROS messages by field name, independent of ROS."""
