"""Estimation of the shape with its uncertainty from readings, and its check with targets."""
