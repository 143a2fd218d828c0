"""Fits of effects jointly with the model."""
