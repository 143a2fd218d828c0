"""The page of an exploration: how the gap shrank, and what was still possible."""
