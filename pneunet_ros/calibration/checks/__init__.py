"""What a calibration has to ask of its recordings and of its result."""
