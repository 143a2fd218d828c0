"""What the nodes do, but on files: replay, track, check."""
