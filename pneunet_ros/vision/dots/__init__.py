"""Dots in an image: round areas, their edges and centers."""
