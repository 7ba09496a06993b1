"""Drawings: strokes and SVG pictures, and the paths that fly them."""
