"""Performance measurements: both sides in one run, order-balanced pairs, medians. `python -m benchmarks`."""
