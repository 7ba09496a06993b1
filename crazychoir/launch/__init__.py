"""Many drones on this machine: one process in virtual time, or processes of agents in real time; and the score."""
