"""What the camera of the virtual lab sees: scene, light, lens, dots, pixels."""
