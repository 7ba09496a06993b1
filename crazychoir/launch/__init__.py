"""Start a swarm on this machine, in virtual or in real time, and score its flight."""
