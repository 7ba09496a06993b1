"""What the drones decide together."""
