"""One process of a swarm: its drones, their missions and the commands of operators."""
