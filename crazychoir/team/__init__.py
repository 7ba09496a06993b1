"""The drones that work together: graph, barrier, epochs and rounds."""
