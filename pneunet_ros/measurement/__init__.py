"""Measurement model y = h(x) + e: meaning of readings, noise, covariance."""
