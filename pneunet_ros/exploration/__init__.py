"""The next recording: remaining causes, and the experiment that separates them."""
