"""Compiled kernels: how they are compiled, linked, kept, and waited for."""
