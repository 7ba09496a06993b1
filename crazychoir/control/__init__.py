"""Controllers: from references to commands."""
