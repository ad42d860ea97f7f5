"""Algorithms for comparison; the tables of `canhaptic.control` name them."""
