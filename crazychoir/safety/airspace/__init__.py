"""The airspace: which drones could meet, and which of their states a drone has heard."""
