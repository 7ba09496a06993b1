"""Pickup-and-delivery instances, plans and their checks."""
