"""Meaning of a sensor's numbers: unit, reference, sign, axes and zero."""
