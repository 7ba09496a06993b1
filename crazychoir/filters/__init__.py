"""Filters: from poses to states."""
