"""Benchmarks: one file a benchmark; most compare crazychoir with other programs in the same run."""
