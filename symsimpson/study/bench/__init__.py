"""Benchmarks of run time against error. They print results; no test depends on them."""
