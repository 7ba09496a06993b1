"""Connections to Crazyflies through cflib: links, dongles, tables of contents."""
