"""Targets in camera images: blobs, which is which, where they are, the smoothed centerline."""
