"""Words that every room uses: arrays, units, frames, errors, stamps, readings."""
