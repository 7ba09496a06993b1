"""The main functions of the processes of a swarm."""
