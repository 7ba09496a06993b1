"""The decide stage: the laws of all drones of a process take one step together."""
