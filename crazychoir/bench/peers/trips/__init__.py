"""The programs of the round trips: 64 bytes between two drones in two processes, one program a file."""
