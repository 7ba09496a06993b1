"""The problems of one agent: models, expressions and their local solvers."""
