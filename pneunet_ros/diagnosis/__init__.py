"""Where model and recordings disagree, and which effect is missing."""
