"""Commands that inspect a running swarm or control it."""
