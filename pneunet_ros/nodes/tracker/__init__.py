"""The node `tracker`."""
