"""Vector mathematics, compiled kernels and their cache."""
