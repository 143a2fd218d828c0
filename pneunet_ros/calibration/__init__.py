"""From recordings to a model with error bars: the two experiments of the paper, fitted jointly."""
