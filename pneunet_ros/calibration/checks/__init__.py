"""Checks of the recordings and the result of a calibration."""
