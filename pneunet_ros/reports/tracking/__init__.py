"""Pictures and films of a tracking."""
