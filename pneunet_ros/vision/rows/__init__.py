"""The row of targets: found in a frame, believed, and moved on to the next one."""
