"""Commands that prepare hosts, keys, radios and motion capture."""
