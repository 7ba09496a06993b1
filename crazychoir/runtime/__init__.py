"""Actors: supervised tasks with mailboxes, on a wall clock or a virtual clock."""
