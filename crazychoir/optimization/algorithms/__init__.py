"""The catalogue of distributed algorithms, one file an algorithm."""
