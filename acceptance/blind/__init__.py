"""Blind trials: recordings with a hidden effect, made, diagnosed and scored apart."""
