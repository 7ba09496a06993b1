"""Measurements of radio channels and links."""
