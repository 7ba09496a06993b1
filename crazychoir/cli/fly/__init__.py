"""Commands that start processes of a flight."""
