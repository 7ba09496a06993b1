"""Command lines: crazychoir and crazychoir-agent."""
