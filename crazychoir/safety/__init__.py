"""Geofence, watchdogs, and what to do in trouble."""
