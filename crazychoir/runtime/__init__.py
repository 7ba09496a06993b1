"""What an actor is: tasks with mailboxes, supervised, on a wall or a virtual clock."""
