"""Small mathematics, compiled kernels and their cache."""
