"""Targets in camera images: detection, identification, measurement, smoothed centerline."""
