"""What several commands use: the chosen swarm and the observer of a running one."""
