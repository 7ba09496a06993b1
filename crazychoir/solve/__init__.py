"""Computation without flight: simulated algorithms and routing in many processes."""
