"""Gradient tracking for losses of many samples."""
