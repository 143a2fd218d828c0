"""The work of the nodes on files: replay, track, check."""
