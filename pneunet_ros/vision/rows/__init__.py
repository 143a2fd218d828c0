"""The row of targets: detection, gating and prediction from frame to frame."""
