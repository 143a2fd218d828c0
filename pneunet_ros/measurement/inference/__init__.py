"""Engines of estimation, which name no unknown: they know means, roots and Jacobians."""
