"""The lightweight world: drones as points with attitude, one integrator."""
