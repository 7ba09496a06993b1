"""Collision avoidance: the states of the others, and the nearest safe acceleration."""
