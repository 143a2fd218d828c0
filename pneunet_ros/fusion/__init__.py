"""One estimate of shape, tip force and pressure bias from all sensors that are there."""
