"""The node `virtual_gripper`."""
