"""Benchmarks that make the source's tables again; each module has SUMMARY and run()."""
