"""The nodes, and all that knows ROS: message -> core -> message, nothing else."""
