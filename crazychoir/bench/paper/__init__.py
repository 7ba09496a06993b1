"""Tables and pictures of the routing benchmarks, for a paper."""
