"""Who is in the swarm, and how its members talk in rounds."""
