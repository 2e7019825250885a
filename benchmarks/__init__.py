"""Benchmarks: ratios against a peer in the same run, warm-up first, median of several."""
