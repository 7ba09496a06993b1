"""Files of the user: folders, texts to read, results to write, and names that are not text."""
