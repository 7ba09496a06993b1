"""Pickup and delivery in flight, planned before or while flying."""
