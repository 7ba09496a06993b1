"""The tick of all drones of a process: batch, stages, and the pilots of the drones."""
