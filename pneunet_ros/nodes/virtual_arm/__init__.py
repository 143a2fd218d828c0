"""The node `virtual_arm`."""
