"""Compiled kernels: compilation, linking, cache, and waiting for them."""
