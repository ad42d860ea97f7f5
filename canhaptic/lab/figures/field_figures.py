"""Figures from the literature on haptic rendering: K-B plot, M-width, rate-hardness, impedance, drag, energy given out.

Errors, force variation, limit cycle and rendered stiffness, which compare with the continuous environment, are in
`figures.py`; the time of a step is in `axis_loop.py`.
"""

import math
from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np

from canhaptic.control.environments import Environment
from canhaptic.lab.loop.axis_loop import Array, LoopRun

NEAR: Final = 0.05
"""Largest relative error of an accurately rendered stiffness."""

_WINDOW: Final = 0.02
"""Time after the first contact in which the rate of the force is measured [s]."""


def energy_given_out(run: LoopRun) -> float:
    """Return the largest net energy that the port generated, after any hold [J]; 0 for a passive run.

    Source: the condition of a passivity observer, Hannaford and Ryu 2002, doi:10.1109/70.988969, here with the energy
    of the plant instead of the booked energy.
    """
    return max(0.0, -run.least_interaction)


def energy_beyond_device(run: LoopRun, device_damping: float, sample_time: float) -> float:
    """Return the largest net energy generated beyond the device's own dissipation, after any hold [J].

    A display with a value of 0 is passive together with its device, even if its rendered environment alone is not:
    Colgate and Schenkel, "Passivity of a class of sampled-data systems", Journal of Robotic Systems 14, 1997 (condition
    quoted from secondary sources). In a hold with the displacement D a damping b dissipates at least b D^2 / T.

    Args:
        run: Run of an axis.
        device_damping: Guaranteed least damping of the device [N*s/m or N*m*s/rad].
        sample_time: Sample time [s].
    """
    moved = np.diff(run.true_position, prepend=run.true_position[:1])
    taken = np.cumsum(device_damping / sample_time * moved**2)
    return max(0.0, -float((run.interaction + taken).min(initial=0.0)))


def rate_hardness(run: LoopRun, environment: Environment, sample_time: float) -> float | None:
    """Return the largest rate of the force after the first contact, over the speed of that contact [N/m or N*m/rad].

    An ideal wall gives its stiffness. Source: Lawrence, Pao, Dougherty, Salada and Pavlou, "Rate-hardness: a new
    performance metric for haptic interfaces", IEEE Trans. Robotics and Automation 16, 2000 (abstract only).

    Args:
        run: Run that begins out of contact.
        environment: Rendered environment.
        sample_time: Sample time [s].

    Returns:
        None where there was no contact, the run began in contact, or the first contact had no speed.
    """
    touching = np.array([bool(environment.contact(q)) for q in run.true_position.tolist()])
    if not touching.any() or touching[0]:
        return None
    first = int(touching.argmax())
    speed = abs(run.true_position[first] - run.true_position[first - 1]) / sample_time
    last = first + max(2, math.ceil(_WINDOW / sample_time))
    rates = np.diff(np.abs(run.torque[first : last + 1])) / sample_time
    return float(rates.max(initial=0.0) / speed) if speed > 0.0 else None


def drag(run: LoopRun) -> float | None:
    """Return the mean magnitude of the torque held out of contact [N or N*m]; None without such a hold.

    It is the lower end of the Z-width, ideally 0: Colgate and Brown, "Factors affecting the Z-width of a haptic
    display", ICRA 1994, pp. 3205-3210 (quoted from secondary sources).
    """
    free = ~np.isfinite(run.damping[1:])  # no hold ends at the first SYNC
    return float(np.abs(run.torque[1:][free]).mean()) if free.any() else None


def rendered_impedance(run: LoopRun, sample_time: float, frequency: float) -> complex:
    """Return force over velocity at one frequency, over the whole periods of the last half [N*s/m or N*m*s/rad].

    A display is transparent if this equals the requested impedance at every frequency. Forces are constant over each
    hold; positions are sampled at the SYNCs.

    Args:
        run: Run with a hand that moves at this frequency, always in contact.
        sample_time: Sample time [s].
        frequency: Frequency [Hz]; below half of the rate.
    """
    omega, count = 2.0 * math.pi * frequency, len(run.position)
    periods = max(1, math.floor(0.5 * count * sample_time * frequency))
    rows = np.arange(count - round(periods / (frequency * sample_time)), count)
    turn = np.exp(-1j * omega * sample_time * rows)
    half = 0.5 * omega * sample_time
    position = np.sum(run.true_position[rows] * turn)
    force = np.sum(-run.torque[rows] * turn) * np.exp(1j * half) * math.sin(half) / half
    return complex(force / (1j * omega * position))


def asked_impedance(stiffness: float, damping: float, frequency: float) -> complex:
    """Return force over velocity of a spring with a damper [N*s/m or N*m*s/rad]."""
    return damping + stiffness / (2j * math.pi * frequency)


class StiffestWalls(NamedTuple):
    """Borders of a K-B plot; the arrays have the shape of the trials without their first dimension."""

    passive: Array  # largest stiffness up to which every wall is passive; 0: not even the least
    near: Array  # largest of these stiffnesses that is rendered within `NEAR`; 0: none
    is_open: Any  # whether every wall tried is passive, so that the border is beyond the range


def stiffest_walls(stiffnesses: Array, passive: Any, shares: Array) -> StiffestWalls:
    """Return the largest stiffness up to which all walls are passive, and the largest of these rendered accurately.

    Plotted over the wall's damping, this is the K-B plot or Z-width of Colgate and Brown 1994, as above.

    Args:
        stiffnesses: Stiffnesses tried, ascending, shape (n,) [N/m or N*m/rad].
        passive: Whether each wall was passive, shape (n, ...).
        shares: Rendered over requested stiffness, shape (n, ...); NaN where unknown.
    """
    kept = np.logical_and.accumulate(np.asarray(passive, dtype=bool), axis=0)
    near = kept & (np.abs(shares - 1.0) <= NEAR)
    column = stiffnesses.reshape(-1, *(1,) * (kept.ndim - 1))
    return StiffestWalls(
        np.where(kept, column, 0.0).max(axis=0), np.where(near, column, 0.0).max(axis=0), np.asarray(kept[-1])
    )


class MWidth(NamedTuple):
    """Range of stable virtual masses [kg or kg*m^2]."""

    least: float  # negative: the largest inertia that can be compensated
    most: float


def m_width(mass: float, damping: float, sample_time: float, delay: int = 0, cutoff: float = math.inf) -> MWidth:
    """Return the range of virtual masses that an unloaded device displays stably.

    Source: Colonnese and Okamura, "M-width: stability and accuracy of haptic rendering of virtual mass", RSS 2012, and
    IJRR 34, 2015, doi:10.1177/0278364914559294 (abstracts only: "the dynamic range of virtual masses renderable in a
    stable manner"). The virtual mass acts on the second backward difference of the sampled position, held over T.
    Without damping, delay and filter the loop is z^2 + (M / 2m) (z + 1) = 0, which is stable for -m < M < 2m.

    Args:
        mass: m, the mass of the device [kg or kg*m^2].
        damping: Damping of the device [N*s/m or N*m*s/rad].
        sample_time: T [s].
        delay: Delay in whole holds.
        cutoff: Cutoff of a first-order low-pass on the acceleration [Hz]; infinite: none.
    """
    decay = math.exp(-damping * sample_time / mass)
    moved = _moved_in_a_hold(mass, damping, sample_time)
    late = -math.expm1(-2.0 * math.pi * cutoff * sample_time) if math.isfinite(cutoff) else 1.0
    free = np.polymul([1.0, -decay], np.polymul([1.0, late - 1.0], [1.0] + [0.0] * (1 + delay)))
    held = np.polymul([1.0, -1.0], moved) * late / sample_time**2
    if damping == 0.0:  # a free mass keeps its speed: that root is no fault of the display
        free, held = np.polydiv(free, [1.0, -1.0])[0], np.polydiv(held, [1.0, -1.0])[0]

    def is_stable(virtual: float) -> bool:
        return bool(np.abs(np.roots(np.polyadd(free, virtual * held))).max() < 1.0)

    return MWidth(_last_stable(is_stable, -mass), _last_stable(is_stable, mass))


def _moved_in_a_hold(mass: float, damping: float, sample_time: float) -> Array:
    """Return [x1, x0] of the transfer function from held force to position, (x1 z + x0) / ((z - 1) (z - p))."""
    ratio = damping * sample_time / mass
    if ratio < 1e-6:
        return np.full(2, 0.5 * sample_time**2 / mass)
    lost = -math.expm1(-ratio)  # 1 - exp(-ratio) would round a small ratio away
    return np.array([ratio - lost, lost - ratio * (1.0 - lost)]) * mass / damping**2


def _last_stable(is_stable: Callable[[float], bool], step: float) -> float:
    """Return the last stable value from zero in the direction of `step`, to six digits; infinite beyond 1e6 steps."""
    inside, outside = 0.0, 1e-3 * step
    while is_stable(outside):
        inside, outside = outside, 1.1 * outside
        if abs(outside) > 1e6 * abs(step):
            return math.copysign(math.inf, step)
    for _ in range(40):
        middle = 0.5 * (inside + outside)
        inside, outside = (middle, outside) if is_stable(middle) else (inside, middle)
    return float(f"{inside:.6g}")
