"""The continuous environments of many loops: their modes as matrices, for the kernel that follows them.

The environments are those with a flow in closed form: `why_not_continuous` says why another has none.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from canhaptic.control.environments.damper_wall import DamperWall
from canhaptic.control.environments.free_space import FreeSpace
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.environments.two_sided_wall import TwoSidedWall
from canhaptic.control.environments.viscous_medium import ViscousMedium
from canhaptic.lab.batch.batch_case import BatchCase
from canhaptic.lab.batch.reference_kernel import ReferenceSettings
from canhaptic.lab.figures.figures import last_rows
from canhaptic.lab.loop.axis_loop import Array
from canhaptic.lab.reference.continuous_reference import readings_per_hold
from canhaptic.sim.plant.propagator import flow_changes

CLOSED_FORM: Final = (SpringDamperWall, TwoSidedWall, DamperWall, ViscousMedium, FreeSpace)
"""Environments that are linear in each of their modes."""
_ANGLE: Final = 0.5
"""Largest sum of the rates of a scene times its step [rad]."""
_MOST_STEPS: Final = 4096
"""Steps per hold beyond which a scene has no reference."""


def why_not_continuous(case: BatchCase) -> str:
    """Reason why continuous runs cannot be followed along with their loops; empty where they can."""
    if not isinstance(case.environment, CLOSED_FORM):
        return f"{type(case.environment).__name__} has no flow in closed form"
    return "" if f"rate.1.{case.size - 2}" in case.numbers else "the plant has effects that are not in arrays"


class _Linear(NamedTuple):
    """Many scenes: y' = F y in each mode, y = [states of the plant..., 1]."""

    rates: tuple[Array, ...]  # by mode, each of shape (n, k, k) [1/s]
    start: Array  # shape (k, n)
    lower: Array  # solid below, -inf for none, shape (n,) [m or rad]
    upper: Array  # solid above, inf for none
    stiffness: Array  # [N/m or N*m/rad]
    damping: Array  # [N*s/m or N*m*s/rad]
    everywhere: bool  # whether the damper acts in every mode


class ContinuousModes(NamedTuple):
    """The continuous environments of some scenes, y = [states of the plant..., 1] of length k."""

    settings: list[ReferenceSettings]  # of each scene
    flows: Array  # by mode: y after a step, shape (n, 3, k, k)
    rates: Array  # by mode: y' = F y, shape (n, 3, k, k) [1/s]
    starts: Array  # y at the first SYNC, shape (n, k)

    @property
    def exist(self) -> Any:
        """Whether each scene has one, shape (n,)."""
        return np.array([settings.exists for settings in self.settings])


def no_modes(count: int) -> ContinuousModes:
    """Placeholder for scenes without continuous environments."""
    nothing = np.zeros((1, 3, 1, 1))
    return ContinuousModes([ReferenceSettings()] * count, nothing, nothing, np.zeros((1, 1)))


def continuous_modes(
    case: BatchCase, numbers: Mapping[str, Any], count: int, cycles: int, *, with_force: bool, with_travel: bool
) -> ContinuousModes:
    """Return the continuous environments of some scenes.

    Args:
        case: Case with an environment of `CLOSED_FORM`.
        numbers: Varied numbers of these scenes.
        count: Number of scenes.
        cycles: SYNCs of the whole run.
        with_force: Whether the force is needed: read as often as `reference.continuous_reference` reads it.
        with_travel: Whether the travel is needed.
    """
    linear = _linear(case, numbers, count)
    period = np.broadcast_to(np.asarray(numbers["loop.sample_time"], dtype=float), (count,))
    readings, last_from = np.ones(count, dtype=np.int64), np.empty(count, dtype=np.int64)
    for value in np.unique(period):
        last_from[period == value] = last_rows(cycles, float(value)).start
        if with_force:
            readings[period == value] = readings_per_hold(round(float(value) * 1e9), cycles)
    steps = 2 ** np.ceil(np.log2(np.maximum(1.0, period * _fastest(linear) / (_ANGLE * readings))))
    step = period / (readings * steps)
    flows = [_flows(rates, step) for rates in linear.rates[:1]]
    flows += [flows[0] if rates is linear.rates[0] else _flows(rates, step) for rates in linear.rates[1:]]
    columns = (
        (steps * readings <= _MOST_STEPS).tolist(), linear.lower.tolist(), linear.upper.tolist(),
        linear.stiffness.tolist(), linear.damping.tolist(), [linear.everywhere] * count, [with_force] * count,
        [with_travel] * count,
        readings.tolist(), steps.astype(np.int64).tolist(), step.tolist(), last_from.tolist(),
    )  # fmt: skip
    settings = [ReferenceSettings(*row) for row in zip(*columns, strict=True)]
    return ContinuousModes(settings, _stacked(flows), _stacked(linear.rates), np.ascontiguousarray(linear.start.T))


def _flows(rates: Array, step: Array) -> Array:
    """State y after a step of y' = F y in many scenes, shape (n, k, k); computed once for equal scenes."""
    if (rates == rates[0]).all():
        step, which = np.unique(step, return_inverse=True)
        return _flows_of_each(rates[: len(step)], step)[which]
    return _flows_of_each(rates, step)


def _flows_of_each(rates: Array, step: Array) -> Array:
    return np.asarray(np.eye(rates.shape[1]) + flow_changes(rates * step[:, None, None]))


def _stacked(modes: Sequence[Array]) -> Array:
    """Return the matrices of the three modes, shape (n, 3, k, k); of an environment without surfaces the same."""
    return np.ascontiguousarray(np.stack([modes[min(mode, len(modes) - 1)] for mode in range(3)], axis=1))


def _linear(case: BatchCase, numbers: Mapping[str, Any], count: int) -> _Linear:
    def number(name: str, absent: float = 0.0) -> Array:
        return np.array(np.broadcast_to(numbers.get(name, absent), (count,)), dtype=float)

    states, environment = case.size - 2, case.environment
    free, start = np.zeros((count, states + 1, states + 1)), np.ones((states + 1, count))
    for row in range(states):
        start[row] = number(f"start.{row}")
        for column in range(states):
            free[:, row, column] = number(f"rate.{row}.{column}")
        free[:, row, states] = number(f"rate.{row}.{states + 1}")
    share = number(f"rate.1.{states}")  # 1 / mass
    stiffness, damping = number("environment.stiffness"), number("environment.damping")
    lower, upper = np.full(count, -np.inf), np.full(count, np.inf)
    everywhere = isinstance(environment, ViscousMedium)
    if everywhere:
        free[:, 1, 1] -= share * damping
    elif isinstance(environment, TwoSidedWall):
        lower, upper = number("environment.lower"), number("environment.upper")
    elif isinstance(environment, SpringDamperWall | DamperWall):
        surface = number("environment.position")
        lower, upper = (surface, upper) if environment.side == "below" else (lower, surface)
    rates = [free]
    for surface in (lower, upper):
        if not np.isfinite(surface).any():
            rates.append(free)  # a mode that nothing enters
            continue
        inside = free.copy()
        inside[:, 1, 0] -= share * stiffness
        inside[:, 1, 1] -= share * damping
        inside[:, 1, states] += share * stiffness * np.where(np.isfinite(surface), surface, 0.0)
        rates.append(inside)
    guarded = bool(np.isfinite(lower).any() or np.isfinite(upper).any())
    return _Linear(tuple(rates if guarded else rates[:1]), start, lower, upper, stiffness, damping, everywhere)


def _fastest(linear: _Linear) -> Array:
    """Bound of the rates of each scene [rad/s]: those of an oscillator, and those of the hand's motion."""
    found = np.zeros(len(linear.lower))
    for rates in linear.rates:
        hand = np.abs(rates[:, 2:-1]).max(axis=(1, 2)) if rates.shape[1] > 3 else 0.0
        found = np.maximum(found, np.sqrt(np.abs(rates[:, 1, 0])) + np.abs(rates[:, 1, 1]) + hand)
    return found
