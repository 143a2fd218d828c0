"""The node `gripper`."""
