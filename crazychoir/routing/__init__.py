"""Pickup and delivery: instances, route pricing, primal decomposition, recovery, checker."""
