"""The flight of one drone: modes, references, limits and landing."""
