"""One marginal likelihood for effects of the library and kinds of discovery: a trial."""
