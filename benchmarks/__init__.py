"""Benchmarks: run from the repository with `make bench-...`; no part of the package."""
