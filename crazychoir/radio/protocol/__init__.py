"""CRTP packets and addresses, without input or output."""
