"""What one agent solves: problems, expressions and their local solvers."""
