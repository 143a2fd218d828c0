"""Diagnosis of a model: location of the misfit, and the missing effect."""
