"""The node `fusion`."""
