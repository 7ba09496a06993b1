"""Distributed assignment of tasks to robots."""
