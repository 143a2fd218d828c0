"""What the numbers of a sensor mean: unit, reference, sign, axes and zero."""
