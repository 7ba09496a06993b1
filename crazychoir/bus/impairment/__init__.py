"""The simulated network: loss, delay, duplication, reordering, bandwidth and partitions."""
