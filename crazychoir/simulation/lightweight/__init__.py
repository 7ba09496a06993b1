"""The lightweight world: drones as points with an attitude, moved by one integrator."""
