"""Benchmarks: one file a benchmark; each compares crazychoir with a peer in the same run."""
