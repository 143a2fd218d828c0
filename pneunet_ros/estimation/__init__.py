"""From readings to a shape with its uncertainty, and whether targets agree with it."""
