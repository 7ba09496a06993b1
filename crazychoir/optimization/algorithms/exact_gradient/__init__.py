"""Algorithms with a constant step that end at the exact optimum: one gradient and one message a round."""
