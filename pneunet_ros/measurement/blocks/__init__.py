"""Causes of error, one file each: what they are before any data, how they move, where they act."""
