"""The virtual lab: simulated recordings with exact ground truth, by independent code."""
