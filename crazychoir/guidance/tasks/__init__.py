"""Tasks that a team shares: the task book, its gossip and its assignment."""
