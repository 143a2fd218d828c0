"""Experiment choice: the remaining causes, and the experiment that separates them."""
