"""Equations of an admittance display and its hand, for a solver that shares no code with the simulated plant.

    M v' = c (r - v) + f_I + F - b v,   f_I' = k (r - v),   F = k_g (x - q) + d_g (w - v)
    m x'' = -F + K (x_u - x) + D (x_u' - w) + push,          E' = F v

q, v: mass on the motor's side of the sensor; x, w: mass on the hand's side; r: velocity command; f_I: integral part of
the velocity loop; F: force at the sensor. Effects and torque limits are omitted.
"""

from collections.abc import Sequence
from math import cos, pi, sin
from typing import Any

import numpy as np

from canhaptic.errors import InputError
from canhaptic.lab.loop.axis_loop import Array
from canhaptic.scene.models import AxisSimulation
from canhaptic.sim.plant.user import SinusoidMotion, UserParameters


def why_no_equations(simulation: AxisSimulation) -> str:
    """Return "" if the equations describe a plant completely, else the name of the part that they omit."""
    display, user = simulation.admittance, simulation.user
    if display is None:
        return "no admittance display"
    if display.loop.torque_limit is not None:
        return "the torque limit of the loop"
    if simulation.effects:
        return f"effect {simulation.effects[0].name}"
    if user is not None and not user.has_equations:
        return "a user-defined or recorded hand"
    return ""


def integrate(simulation: AxisSimulation, held: Sequence[float], sample_time: float) -> Array:
    """Return position [m or rad] and energy through the sensor [J] at each SYNC, shape (len(held), 2), by DOP853.

    Args:
        simulation: Simulation of the axis.
        held: Velocity command in the hold before each SYNC [m/s or rad/s]; the first is not used.
        sample_time: T [s].

    Raises:
        InputError: `why_no_equations` names a part, or the solver failed.
    """
    from scipy.integrate import solve_ivp

    if reason := why_no_equations(simulation):
        raise InputError(f"no equations here for {reason}")
    state = np.zeros(6)  # q, v, x, w, f_I, E
    state[0] = state[2] = simulation.plant.initial_position
    state[1] = state[3] = simulation.plant.initial_velocity
    rows, rates = [state[[0, 5]]], _rates(simulation)
    for number, command in enumerate(held[1:]):
        span = (number * sample_time, (number + 1) * sample_time)
        found: Any = solve_ivp(rates, span, state, "DOP853", args=(command,), rtol=1e-11, atol=1e-14)
        if not found.success:
            raise InputError(f"DOP853: {found.message}")
        state = found.y[:, -1]
        rows.append(state[[0, 5]])
    return np.array(rows)


def _rates(simulation: AxisSimulation) -> Any:
    display, user, plant = simulation.admittance, simulation.user or UserParameters(), simulation.plant
    if display is None:
        raise InputError("no equations for an axis that is not an admittance display")
    loop, grip = display.loop, display.grip
    motion = user.sinusoid or SinusoidMotion(amplitude=0.0, frequency=1.0)
    omega = 2.0 * pi * motion.frequency

    def rates(time: float, state: Array, command: float) -> list[float]:
        q, v, x, w, integral, _ = state.tolist()
        angle = omega * time + motion.phase
        place = user.rest + motion.offset + motion.amplitude * sin(angle)
        speed = motion.amplitude * omega * cos(angle)
        force = grip.stiffness * (x - q) + grip.damping * (w - v)
        hand = user.stiffness * (place - x) + user.damping * (speed - w) + user.push
        driven = loop.gain * (command - v) + integral - plant.damping * v
        forced = (driven + force) / plant.mass, (hand - force) / grip.mass
        return [v, forced[0], w, forced[1], loop.integral_gain * (command - v), force * v]

    return rates
