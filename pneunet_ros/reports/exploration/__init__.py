"""The page of an exploration: how the model error shrank, and what was still possible."""
