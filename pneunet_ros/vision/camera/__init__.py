"""The camera: its lens, its settings, and the plane in which the arm bends."""
