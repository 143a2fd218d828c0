"""Causes of error, one file each: prior, process noise, and where they enter the model."""
