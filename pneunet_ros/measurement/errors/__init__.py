"""Errors of readings and model, and the covariance that follows."""
