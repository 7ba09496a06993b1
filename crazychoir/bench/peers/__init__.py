"""The programs that benchmarks run as processes of their own: our own and the peers."""
