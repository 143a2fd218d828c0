"""Estimation algorithms for generic unknowns: means, square roots and Jacobians."""
