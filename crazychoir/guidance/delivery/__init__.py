"""Pickup and delivery, planned before the flight or during the flight."""
