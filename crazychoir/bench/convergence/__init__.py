"""Distributed algorithms side by side on random problems: error against rounds, messages and bytes."""
