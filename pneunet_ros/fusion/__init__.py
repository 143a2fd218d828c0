"""One estimate of shape, tip force and pressure bias from all available sensors."""
