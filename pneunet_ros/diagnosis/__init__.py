"""Where simulation and measurement disagree, what is missing, and how sure that is."""
