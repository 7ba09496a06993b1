"""Figures, comparisons and plots of recordings."""
