"""Motion capture sources."""
