"""The swarm file: its tables, reader, checks and what follows from them."""
