"""Algorithms to compare with; the tables of `canhaptic.control` name them."""
