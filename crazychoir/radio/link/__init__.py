"""Connections to Crazyflies through cflib: links, dongles, and tables of contents."""
