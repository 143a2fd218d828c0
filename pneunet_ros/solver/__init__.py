"""The boundary value problem of the rod as compiled kernels."""
