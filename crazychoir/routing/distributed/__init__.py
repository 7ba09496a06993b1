"""The distributed method: each robot prices its own routes, and the team agrees on a plan."""
