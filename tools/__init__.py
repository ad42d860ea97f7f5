"""Thin scripts and benchmarks."""
