"""Motion capture: sources of poses, and the process that publishes them."""
