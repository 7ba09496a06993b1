"""Drones that are equations."""
