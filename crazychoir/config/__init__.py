"""The swarm file: its tables, its reader, its checks, and the values that follow from them."""
