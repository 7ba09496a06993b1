"""Costs and states that change while the team computes."""
