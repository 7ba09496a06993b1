"""Algorithms that send compressed messages and keep the error for later rounds."""
