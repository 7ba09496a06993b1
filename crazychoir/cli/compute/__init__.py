"""Commands that compute without flying."""
