"""What a log proves: the account read back, recomputed and re-derived from raw frames."""
