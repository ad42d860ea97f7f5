"""Durations of a whole run in constant memory: a histogram with bins of 1 us and an exact maximum."""

from typing import Final

_BIN: Final = 1_000  # [ns]
_BINS: Final = 20_000  # durations of 20 ms and more share the last bin; their maximum is kept exactly


class DurationHistogram:
    """Counts of durations [ns], for quantiles that are right to one bin (1 us)."""

    def __init__(self) -> None:
        self._counts = [0] * (_BINS + 1)
        self.total = 0
        self.maximum = 0

    def add(self, duration: int) -> None:
        """Count one duration [ns]; a negative one counts as zero."""
        index = duration // _BIN
        self._counts[0 if index < 0 else index if index < _BINS else _BINS] += 1
        self.total += 1
        if duration > self.maximum:
            self.maximum = duration

    def quantile(self, fraction: float) -> float:
        """Return the duration [s] that `fraction` of all entries do not exceed, rounded up to a bin; 0 when empty."""
        if not self.total:
            return 0.0
        needed = fraction * self.total
        seen = 0
        for index, count in enumerate(self._counts):
            seen += count
            if count and seen >= needed:
                return min((index + 1) * _BIN, self.maximum) * 1e-9 if index < _BINS else self.maximum * 1e-9
        return 0.0

    def summary(self) -> dict[str, float]:
        """Return p50, p99, p99.9 and the maximum [s]."""
        return {
            "p50": self.quantile(0.5),
            "p99": self.quantile(0.99),
            "p99.9": self.quantile(0.999),
            "max": self.maximum * 1e-9,
        }
