"""Guidance: the decisions that the drones make together."""
