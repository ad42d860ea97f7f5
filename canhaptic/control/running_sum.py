"""Sums of many terms of both signs, without drift: of kernels, and of the account of a run."""

from dataclasses import dataclass


@dataclass(slots=True)
class RunningSum:
    """A sum and, apart, the sum of its rounding errors (two-sum, Knuth): no drift over any number of terms."""

    total: float = 0.0
    error: float = 0.0

    @property
    def value(self) -> float:
        """The sum."""
        return self.total + self.error


def add(running: RunningSum, term: float) -> float:
    """Add a term and return the value of the sum."""
    before = running.total
    total = before + term
    part = total - before
    running.error += (before - (total - part)) + (term - part)
    running.total = total
    return total + running.error
