"""Code that several commands share: the chosen swarm, and the observer of a running swarm."""
