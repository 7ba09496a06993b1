"""From poses to states."""
