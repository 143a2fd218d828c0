"""ROS messages by field name, without ROS."""
