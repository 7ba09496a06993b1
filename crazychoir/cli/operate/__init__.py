"""Commands that look into a running swarm or steer it."""
