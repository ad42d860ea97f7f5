"""Passivity algorithms of other authors, for comparison; the tables of `canhaptic.control` make them selectable."""
