"""Identify the parameters of one drone from recordings of its flights."""
