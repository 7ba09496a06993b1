"""Checks that a body seen by the cameras is this drone."""
