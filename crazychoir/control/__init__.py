"""From references to commands."""
