"""The motor-level world: bodies, rotors, batteries and inertial sensors."""
