"""Simulated drones: worlds computed from equations of motion."""
