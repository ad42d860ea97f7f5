"""Exact flows of a linear system over T / 2^j, j = 0..24, and the energy integrals along them.

The matrix exponential is a Taylor series at the smallest step, doubled up to T. The doubling is that of the exponential
MINUS the identity, E(2h) = 2 E(h) + E(h)^2: doubling exp(F h) itself would amplify the rounding of its ones by 2^24.
Energies are integrals of a quadratic power z'Sz along the flow (Van Loan, IEEE Trans. Automatic Control 23(3), 1978);
they are doubled by Q(2h) = Q(h) + Phi(h)' Q(h) Phi(h).

`SampleClock` counts time in whole ticks of T / 2^24 since an epoch, so that k sample times are exactly k steps.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from canhaptic.errors import ParameterError
from canhaptic.sim.plant import LEVELS

Array = NDArray[np.float64]

TICKS: Final = 1 << LEVELS
"""Ticks in one sample time; all time inside the plant is an integer number of them."""
_LARGEST_STEP: Final = 0.25  # of ||F h||: the series then needs about a dozen terms
_TERMS: Final = 16  # of the series of many matrices: 4^-16 / 16! is below 1e-22


def series(first: Array, following: Callable[[Array], Array]) -> Array:
    """Return the sum of a series, up to the first term that is lost in rounding.

    Args:
        first: First term.
        following: Function of the term of order k - 1 that returns k times the term of order k.
    """
    term, total, order = first, first.copy(), 1
    while np.abs(term).max() > 1e-18 * np.abs(total).max():
        order += 1
        term = following(term) / order
        total += term
    return total


def taylor_flow(rates: Array, step: float) -> Array:
    """Return exp(F h) - I by its Taylor series; for ||F h|| below about one.

    Args:
        rates: F of dz/dt = F z, shape (n, n).
        step: h [s].
    """
    scaled = rates * step
    return series(scaled, lambda term: term @ scaled)


def _taylor_work(rates: Array, power: Array, step: float) -> Array:
    """Return Q with z'Qz = integral over h of the power z'Sz along the flow, by its Taylor series.

    Args:
        rates: F of dz/dt = F z, shape (n, n).
        power: S, symmetric, shape (n, n) [W per unit of z squared].
        step: h [s].
    """
    scaled = rates * step
    return series(power, lambda term: scaled.T @ term + term @ scaled) * step


def smallest_step(rates: Array, sample_time: float) -> tuple[float, int]:
    """Return T / 2^j [s] and j, which is `LEVELS`, or more if the series of the fastest mode needs it."""
    needed = LEVELS
    while float(np.abs(rates).sum(axis=0).max()) * sample_time * 0.5**needed > _LARGEST_STEP:
        needed += 1
    return sample_time * 0.5**needed, needed


def doublings(rates: Array, step: float, halvings: int) -> Iterator[tuple[int, Array]]:
    """Yield the level and exp(F h) - I for h = `step` at level `halvings`, doubled from level to level down to 0."""
    change = taylor_flow(rates, step)
    for level in range(halvings, -1, -1):
        yield level, change
        change = 2.0 * change + change @ change


def dyadic_flows(rates: Array, powers: Sequence[Array], sample_time: float) -> tuple[list[Array], list[Array]]:
    """Return exp(F T / 2^j) and the energy forms over T / 2^j, for j = 0..LEVELS.

    Args:
        rates: F of dz/dt = F z, shape (n, n).
        powers: One symmetric S per kind of energy, shape (n, n).
        sample_time: T [s].

    Returns:
        Flows by j, and for each j the Q by kind, shape (kinds, n, n).
    """
    identity = np.eye(len(rates))
    step, halvings = smallest_step(rates, sample_time)
    works = np.array([_taylor_work(rates, power, step) for power in powers]).reshape(-1, *rates.shape)
    flows: list[Array] = []
    forms: list[Array] = []
    for level, change in doublings(rates, step, halvings):
        if level <= LEVELS:
            flows.append(identity + change)
            forms.append(0.5 * (works + works.transpose(0, 2, 1)))
        if len(works):
            works = works + _congruent(works, change)
    return flows[::-1], forms[::-1]


def _congruent(works: Array, change: Array) -> Array:
    """Return (I + E)' Q (I + E) of each Q without adding E to the identity first, which would round E off."""
    products = works @ change
    return works + products + products.transpose(0, 2, 1) + change.T @ products


def flow_changes(rates: Array) -> Array:
    """Return exp(F) - I of many matrices, each computed independently, shape (n, k, k).

    A series with a fixed number of terms at F / 2^h, whose norm is at most 1/4, then h doublings; h differs by matrix.

    Args:
        rates: F, each multiplied by its step, shape (n, k, k).
    """
    norms = np.abs(rates).sum(axis=1).max(axis=1)
    halvings = np.maximum(0, np.ceil(np.log2(np.maximum(norms / _LARGEST_STEP, 1e-300)))).astype(int)
    term = rates * (0.5**halvings)[:, None, None]
    scaled = term
    change: Array = term.copy()
    for order in range(2, _TERMS):
        term = term @ scaled / order
        change += term
    for level in range(int(halvings.max(initial=0))):
        rows = np.flatnonzero(halvings > level)
        some = change[rows]
        change[rows] = 2.0 * some + some @ some
    return change


class SampleClock:
    """Base of plants whose time is counted in ticks since an epoch; they are at rest until `begin`.

    Args:
        sample_time_ns: T [ns].

    Attributes:
        tick: Present tick.
        tick_time: Duration of a tick [s].

    Raises:
        ParameterError: The sample time is below 1 ns.
    """

    def __init__(self, sample_time_ns: int) -> None:
        if sample_time_ns < 1:
            raise ParameterError(f"sample time: got {sample_time_ns} ns, expected at least 1 ns; lower the rate")
        self.sample_time_ns = sample_time_ns
        self.tick_time = sample_time_ns * 1e-9 / TICKS
        self._epoch: int | None = None
        self.tick = 0

    def begin(self, now: int) -> None:
        """Start the clock: `now` [ns] is the epoch, the state there is the initial one. Later calls change nothing."""
        if self._epoch is None:
            self._epoch = now

    def pass_until(self, now: int) -> int:
        """Advance the clock to `now` [ns], rounded to a tick, and return the ticks that passed; 0 before `begin`.

        Raises:
            ParameterError: `now` lies before the last call.
        """
        if self._epoch is None:
            return 0
        tick = ((now - self._epoch) * TICKS + self.sample_time_ns // 2) // self.sample_time_ns
        ticks = tick - self.tick
        if ticks < 0:
            raise ParameterError(f"time went back: got {now} ns, {-ticks} ticks before the last call")
        self.tick = tick
        return ticks

    def require_finite(self, name: str, values: Iterable[float]) -> None:
        """Refuse values given from outside, before anything moves.

        Raises:
            ParameterError: A value is not finite.
        """
        for value in values:
            if not math.isfinite(value):
                raise self.not_finite(name, value)

    def not_finite(self, name: str, value: float) -> ParameterError:
        """Return the error about a value from outside that is not finite."""
        now = self.tick * self.tick_time
        text = f"plant at {now:.6g} s: got {name} {value}, expected a finite number"
        return ParameterError(f"{text}; see what computed it")
