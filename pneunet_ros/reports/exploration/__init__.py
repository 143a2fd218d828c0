"""The page of an exploration: model error and remaining hypotheses by round."""
