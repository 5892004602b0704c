"""Benchmarks: the source's tables and figures made again; `python -m bench` runs them."""
