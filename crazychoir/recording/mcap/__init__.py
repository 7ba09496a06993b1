"""Recordings as MCAP files: records, messages and their definitions."""
