"""Common basis of all packages: arrays, units, frames, errors, stamps, readings."""
