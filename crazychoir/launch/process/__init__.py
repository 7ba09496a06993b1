"""What the main functions of all processes share."""
