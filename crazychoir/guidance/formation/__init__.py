"""Formation laws, and the shapes that they hold."""
