"""What we claim of speed, measured: both sides in one run, order-balanced pairs, medians. `python -m benchmarks`."""
