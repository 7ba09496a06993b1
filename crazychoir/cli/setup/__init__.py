"""Commands that prepare hosts, radios, keys and motion capture for a flight."""
