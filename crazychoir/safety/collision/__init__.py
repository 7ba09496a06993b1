"""Collision avoidance: the nearest safe acceleration, and plans that keep apart."""
