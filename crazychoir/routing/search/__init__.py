"""Local search for good plans: ruin and recreate, insertion and set partitioning."""
