"""Distributed optimisation: problems and algorithms as pure rounds."""
