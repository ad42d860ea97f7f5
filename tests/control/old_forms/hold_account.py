from dataclasses import dataclass, field
from math import inf
from typing import NamedTuple, Protocol

from canhaptic.control.balance import Certificate, EnergyBalance
from canhaptic.control.damping import DamperVelocity, VelocityWindow, restart, update
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.control.passivity.stepped import Commands, as_far_as_limit, efforts_inside, no_commands, repeat, send
from canhaptic.kernels import Buffer, MakeBuffer, new


@dataclass(frozen=True, slots=True)
class HoldSettings:
    sample_time: float
    delay: int
    torque_limit: float
    tolerance: float
    longest_window: int
    certificate: int


@dataclass(slots=True)
class Axis:
    started: bool = False
    position: float = 0.0
    moved: float = 0.0
    missed: int = 0
    lasted: float = 1.0
    oldest: int = 0
    h_dis: float = 0.0
    window: VelocityWindow = field(default_factory=VelocityWindow)


class AxisMemory(NamedTuple):
    samples: Buffer
    commands: Commands


class Hold(NamedTuple):
    displacement: float
    damper: float
    h_i: float
    h_pas: float
    elapsed: float
    velocity: float


class HoldAccount(NamedTuple):
    branch: int
    h_r: float
    gen: float
    deficit: float
    leak: float


def hold_settings(parameters: DamperVelocity, loop: LoopProperties, certificate: Certificate) -> HoldSettings:
    tolerance = parameters.window_tolerance(loop.encoder_count)
    longest = parameters.longest_window(loop.sample_time) if tolerance else 0
    limit = inf if loop.torque_limit is None else loop.torque_limit
    return HoldSettings(loop.sample_time, loop.delay, limit, tolerance, longest, certificate.value)


def axis_memory(delay: int, longest_window: int, make_buffer: MakeBuffer) -> AxisMemory:
    return AxisMemory(make_buffer(longest_window + 1 if longest_window else 0), no_commands(delay, make_buffer))


class _WithHold(Protocol):
    @property
    def hold(self) -> HoldSettings: ...


def hold_memory(settings: _WithHold, make_buffer: MakeBuffer) -> AxisMemory:
    return axis_memory(settings.hold.delay, settings.hold.longest_window, make_buffer)


def begin(axis: Axis, memory: AxisMemory, position: float) -> None:
    axis.started, axis.position, axis.missed, axis.lasted, axis.h_dis = (True, position, 0, 1.0, 0.0)
    if len(memory.samples) > 0:
        restart(axis.window, memory.samples, position)


def open_hold(settings: HoldSettings, axis: Axis, memory: AxisMemory, position: float, torque_applied: float) -> Hold:
    displacement, holds = (position - axis.position, axis.missed + axis.lasted)
    h_i, elapsed = (-torque_applied * displacement, settings.sample_time * holds)
    if axis.missed:
        h_i -= let_samples_pass(axis, memory.commands, displacement, torque_applied, settings.torque_limit)
    damper, modulated = efforts_inside(memory.commands, axis.oldest, torque_applied)
    velocity = displacement / elapsed
    if settings.tolerance:
        if holds > 1.0:
            restart(axis.window, memory.samples, position)
        else:
            update(axis.window, memory.samples, settings.tolerance, elapsed, position)
            velocity = axis.window.velocity
    axis.position, axis.moved, axis.lasted = (position, displacement, 1.0)
    return new(Hold, (displacement, damper, h_i, modulated * displacement, elapsed, velocity))


def let_samples_pass(
    axis: Axis, commands: Commands, displacement: float, torque_applied: float, torque_limit: float
) -> float:
    differences = largest = 0.0
    for _ in range(axis.missed):
        difference = abs(as_far_as_limit(commands.torques[axis.oldest], torque_limit) - torque_applied)
        differences, largest = (differences + difference, max(largest, difference))
        axis.oldest = repeat(commands, axis.oldest)
    skipped = axis.lasted - 1.0
    excursion = abs(displacement) + (axis.missed + skipped) * abs(axis.moved)
    axis.missed = 0
    return (differences + skipped * largest) * excursion


def close_hold(
    settings: HoldSettings,
    axis: Axis,
    memory: AxisMemory,
    hold: Hold,
    account: HoldAccount,
    efforts: tuple[float, float, float],
    rendered: float,
    state: float,
    h_s: float,
) -> EnergyBalance:
    _, _, h_i, h_pas, _, _ = hold
    branch, h_r, gen, deficit, leak = account
    h_dis, paid = surplus_after(axis, hold, account)
    axis.h_dis = h_dis
    spring, damper, modulated = efforts
    torque = -spring - damper - modulated
    axis.oldest = send(memory.commands, axis.oldest, torque, damper, modulated)
    return new(
        EnergyBalance,
        (
            torque,
            h_i,
            h_pas,
            h_i - h_pas,
            h_r,
            h_s,
            h_dis,
            gen,
            deficit,
            leak,
            paid,
            branch,
            rendered,
            settings.certificate,
            state,
        ),
    )


def surplus_after(axis: Axis, hold: Hold, account: HoldAccount) -> tuple[float, float]:
    _, _, gen, deficit, leak = account
    surplus = axis.h_dis + gen + deficit - hold.h_pas
    paid = min(leak, surplus) if leak > 0.0 and surplus > 0.0 else 0.0
    return (surplus - paid, paid)
