"""Evidence in a log: the account read back, recomputed and re-derived from raw frames."""
