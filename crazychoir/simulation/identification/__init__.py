"""Compare the motor-level simulator with recorded flights of real drones, and fit it to them."""
