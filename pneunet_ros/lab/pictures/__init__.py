"""Camera of the virtual lab: scene, light, lens, dots and pixels."""
