"""Choice of the experiment that best separates the remaining causes."""
