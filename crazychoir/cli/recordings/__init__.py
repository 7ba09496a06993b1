"""Commands that write, read and convert recordings."""
