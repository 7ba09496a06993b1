"""The user's files: folders, texts to read, results to write, and names that are not valid text."""
