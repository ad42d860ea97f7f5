"""The account of `guarded`: its state between two SYNCs, and the booking of a hold that ended."""

from dataclasses import dataclass, field
from typing import Final, NamedTuple

from canhaptic.control.certificates.certified_torque import free_energy
from canhaptic.control.certificates.torque_bound import (
    BoundMemory,
    TorqueBound,
    bound_memory,
    end_gap,
    end_hold,
    keep,
    shorten,
)
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.guarded_settings import GuardedSettings
from canhaptic.control.passivity.hold_account import Axis, AxisMemory, axis_memory
from canhaptic.control.passivity.in_flight import as_far_as_limit, efforts_inside, repeat
from canhaptic.control.passivity.prediction import PredictedMotion, observe, observe_mean
from canhaptic.control.passivity.settlement import settle
from canhaptic.control.velocity import restart, update
from canhaptic.kernels import MakeBuffer

_FADE: Final = 0.8
"""Share of the device's past dissipation that still counts after another hold out of contact."""


@dataclass(slots=True)
class GuardedState:
    """State kept from SYNC to SYNC."""

    zone: int = 0  # of contact
    true: float = 0.0  # displacement of the storage in the continuous environment [m or rad]
    h_s: float = 0.0  # [J]
    kept_back: float = 0.0  # dissipated or leaked, and not paid [J]
    axis: Axis = field(default_factory=Axis)
    bound: TorqueBound = field(default_factory=TorqueBound)
    motion: PredictedMotion = field(default_factory=PredictedMotion)


class Memory(NamedTuple):
    """Buffers of one axis."""

    axis: AxisMemory
    bound: BoundMemory


def memory_of(settings: GuardedSettings, make_buffer: MakeBuffer) -> Memory:
    """Return the buffers of one axis."""
    axis = axis_memory(settings.declared.delay, settings.longest_window, make_buffer)
    return Memory(axis, bound_memory(settings.declared, axis.commands.torques, make_buffer))


def end(
    settings: GuardedSettings, state: GuardedState, memory: Memory, position: float, torque_applied: float
) -> tuple[float, float, float, float]:
    """End a hold; return (displacement, damper effort, modulated effort, uncertain energy)."""
    declared, bound, axis, commands = settings.declared, state.bound, state.axis, memory.axis.commands
    displacement, count, oldest = position - axis.position, declared.encoder_count, axis.oldest
    axis.position = position
    if axis.missed:
        axis.missed += int(axis.lasted - 1.0)  # of SYNCs that were skipped in the gap no sample came either
        axis.lasted = 1.0
        return displacement, 0.0, 0.0, end_several(settings, state, memory, displacement, torque_applied)
    bound.first = oldest - declared.delay
    unsure = end_hold(declared, bound, memory.bound, displacement, torque_applied)
    if axis.lasted > 1.0:
        shorten(declared, bound, axis.lasted)
        observe_mean(state.motion, displacement / axis.lasted)
        restart_at_mean(settings, axis, memory.axis, displacement / axis.lasted)
        axis.lasted = 1.0
    else:
        observe(settings.prediction, state.motion, displacement, torque_applied)
        if count:
            update(axis.window, memory.axis.samples, count, settings.sample_time, position)
    if commands.torques[oldest] == torque_applied:
        return displacement, commands.dampers[oldest], commands.modulated[oldest], unsure
    damper, modulated = efforts_inside(commands, oldest, torque_applied)
    return displacement, damper, modulated, unsure


def end_several(
    settings: GuardedSettings, state: GuardedState, memory: Memory, displacement: float, torque_applied: float
) -> float:
    """End several holds of which only the last sample came; return the uncertain energy [J]."""
    axis, commands, holds = state.axis, memory.axis.commands, state.axis.missed + 1
    largest, apart = abs(torque_applied), 0.0
    for _ in range(axis.missed):
        sent = as_far_as_limit(commands.torques[axis.oldest], settings.torque_limit)
        largest, apart = max(largest, abs(sent)), max(apart, abs(sent - torque_applied))
        axis.oldest = repeat(commands, axis.oldest)
    axis.missed = 0
    observe_mean(state.motion, displacement / holds)
    state.bound.first = axis.oldest - settings.declared.delay
    restart_at_mean(settings, axis, memory.axis, displacement / holds)
    return end_gap(settings.declared, state.bound, displacement, torque_applied, holds, largest, apart)


def restart_at_mean(settings: GuardedSettings, axis: Axis, memory: AxisMemory, moved: float) -> None:
    """Restart the velocity's window after holds with this mean displacement [m or rad]."""
    if settings.longest_window:
        restart(axis.window, memory.samples, axis.position)
        axis.window.velocity = moved / settings.sample_time


def book(
    settings: GuardedSettings,
    state: GuardedState,
    memory: Memory,
    h_i: float,
    h_pas: float,
    damped: float,
    ceiling: float,
) -> tuple[float, float, float, float]:
    """Book one hold into store and surplus; return (h_r, deficit, leak, paid) [J].

    Args:
        settings: Constants of the run.
        state: State of the axis; changed.
        memory: Buffers of the axis.
        h_i: Interaction energy of the hold [J].
        h_pas: Part of it taken by the modulated damper [J].
        damped: Damper effort inside the applied torque times the displacement [J].
        ceiling: Energy that the environment stores at its true state [J]; no more is kept than `earned_energy` beyond
            it.
    """
    axis = state.axis
    h_s, surplus = state.h_s + h_i - h_pas, axis.h_dis - h_pas
    slack = 0.0
    ceiling += settings.earned
    if damped > 0.0 or h_s > ceiling:
        slack = free_energy(settings.declared, state.bound, memory.bound, h_s - surplus + settings.credit)
        if slack > h_s:
            slack = h_s
    elif h_s >= 0.0:  # nothing is dissipated, leaked or lacking: nothing is to be settled
        state.h_s, axis.h_dis = h_s, surplus
        return 0.0, 0.0, 0.0, 0.0
    state.h_s, axis.h_dis, h_r, deficit, leak, paid = settle(h_s, surplus, damped, ceiling, slack)
    state.kept_back += h_r + leak - paid
    return h_r, deficit, leak, paid


def relax(
    environment: Environment, settings: GuardedSettings, state: GuardedState, true: float, ceiling: float, holds: float
) -> tuple[float, float, float]:
    """Return (state, energy there, energy dissipated) after internal relaxation for some holds [m or rad, J, J]."""
    relaxed = environment.relaxed(true, holds * settings.sample_time)
    left = environment.stored_energy(relaxed)
    lost = min(state.h_s, max(0.0, ceiling - left))
    state.h_s -= lost
    state.kept_back += lost
    return relaxed, left, lost


def fade(settings: GuardedSettings, state: GuardedState) -> None:
    """Reduce the device's past dissipation, out of contact, to what is kept for later contacts."""
    bound, energy = state.bound, state.h_s - state.axis.h_dis
    have = max(0.0, energy + bound.dissipated)
    keep(bound, energy, max(_FADE * have, settings.earned))
