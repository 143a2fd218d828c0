"""Trial of a single marginal likelihood for library effects and kinds of discovery."""
