"""Benchmarks: the source's tables and figures made again; `globule bench` runs them."""
