"""The command lines crazychoir, crazychoir-agent and those of the other processes of a flight."""
