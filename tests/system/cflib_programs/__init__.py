"""Programs as cflib's documentation shows them: they know cflib and a uri, and nothing of this project."""
