"""Forces that are not piecewise affine: their sum is held over each substep of the exact core and solved with it.

All such forces act on the motor's body. Over a substep their sum F is constant, so that the core stays exact. F is the
sum of their means along the travel that F itself causes (a discrete gradient for a force with a potential), found by a
bracketed secant. A substep ends at its first event, and its remainder is solved anew: a force of sliding never acts on
a body that sticks, and the method has order 2 in the substep, with events too. The work booked is F times travel, so
that the balance of energies closes at every step (Gonzalez, J. Nonlinear Science 6, 1996).

`Effort` describes the forces of the package, each as its mean over a substep; the equations are in the files of the
effects. The functions are kernels, for single plants and for compiled batches.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import copysign, exp, expm1, inf, log1p, pi, sin
from typing import Any, Final

from canhaptic.sim.plant.assembly import Account, NonlinearForce
from canhaptic.sim.plant.hybrid_automaton import HybridAutomaton
from canhaptic.sim.plant.propagator import TICKS

_CLOSE: Final = 1e-13  # of the largest force seen in the substep
_JUMP: Final = 1e-9  # what the grid of ticks may leave over; more is a jump
_SECANT_STEPS: Final = 12  # then bisection
_LARGEST_COUNT: Final = 90
_SETTLED: Final = 1e-12  # of a step of the torque: the rest then shows no more how fast it went
_FLATTEST: Final = -0.05  # a residual flatter than that is taken as this steep


class Splitting:
    """The exact core together with the forces that are not piecewise affine (`efforts`).

    Attributes:
        work: Work of these forces by account since the start [J].
    """

    def __init__(self, machine: HybridAutomaton, substeps: int) -> None:
        self._machine = machine
        self._efforts: list[NonlinearForce] = machine.scene.efforts
        self._substep_ticks = TICKS // substeps
        self._tick_time = machine.tick_time
        names = machine.scene.names
        self._travel, self._effort = names.index("travel"), names.index("effort")
        self._torque = names.index(machine.scene.motor_torque)
        self.reset()

    def reset(self) -> None:
        """Return the forces to their initial state, with no work booked."""
        for effort in self._efforts:
            effort.reset()
        self.work: dict[Account, float] = {"motor": 0.0, "user": 0.0, "dissipated": 0.0}
        self._force, self._slope, self._passed = 0.0, -1.0, 0
        self._start = self._duration = self._held = 0.0

    def stored(self, position: float) -> float:
        """Return the energy stored in the efforts [J]."""
        return sum(effort.stored(position) for effort in self._efforts)

    def run(self, ticks: int) -> None:
        """Move by `ticks`, in substeps that end at their first event at the latest.

        Raises:
            EventLimitError: There are more events than allowed.
        """
        while ticks:
            ticks -= self._substep(min(ticks, self._substep_ticks))
            self._machine.check_limit(ticks)

    def _substep(self, ticks: int) -> int:
        """Move by `ticks` or to the first event; return the ticks that passed."""
        state = self._machine.state
        self._start, self._held = float(state[0]), float(state[self._torque])
        force = self._solve(ticks)
        travel = float(self._machine.state[self._travel])
        rest = force
        for effort in self._efforts:
            share = effort.force(self._start, travel, self._duration, self._held)
            rest -= share
            before = effort.stored(self._start)
            effort.commit(self._start, travel, self._duration, self._held)
            stored = effort.stored(self._start + travel) - before
            self._book(effort.account, share * travel + (stored if effort.account == "dissipated" else 0.0))
        self._book("dissipated", rest * travel)  # what the solution of the scalar equation left over
        self._force = force
        return self._passed

    def _book(self, account: Account | None, work: float) -> None:
        if account is not None:
            self.work[account] += -work if account == "dissipated" else work

    def _solve(self, ticks: int) -> float:
        """Return F with F = sum of forces(travel(F)); the machine is then at the end of the piece with that F.

        If no F is consistent with the first event (the mean of a force that still grows stops the body as soon as it
        breaks away), one F is used through all events of the piece, which is then of order 1.
        """
        self._saved, self._begin, self._ticks = self._machine.save(), self._held, ticks
        self._move: Callable[[int], int] = self._machine.run_to_event
        force, self._slope, found = fixed_point(self, self._force, self._slope)
        if not found:
            self._move = self._machine.run
            force, self._slope, _ = fixed_point(self, self._force, -1.0)
        return force

    def residual(self, force: float) -> float:
        """Sum of the forces along the displacement that a given force causes, minus that force."""
        self._machine.restore(self._saved)
        state = self._machine.state
        state[self._effort], state[self._travel] = force, 0.0
        self._passed = self._ticks - self._move(self._ticks)
        self._duration = self._passed * self._tick_time
        travel = float(self._machine.state[self._travel])
        self._held = mean_torque(self._begin, float(self._machine.state[self._torque]), float(state[-2]))
        total = 0.0
        for effort in self._efforts:
            total += effort.force(self._start, travel, self._duration, self._held)
        return total - force


def mean_torque(begin: float, end: float, held: float) -> float:
    """Mean of a torque that goes from `begin` to `end` with a first-order lag behind `held`."""
    gap, left = begin - held, end - held
    if gap in (0.0, left) or not left / gap > _SETTLED:
        return end
    return held + (left - gap) / log1p((left - gap) / gap)


def residual(piece: Any, force: float) -> float:
    """Return the residual of a trial force [N or N*m]: the forces that it leads to, minus itself; decreasing in it."""
    found: float = piece.residual(force)
    return found


def fixed_point(piece: Any, start: float, slope: float) -> tuple[float, float, bool]:
    """Return (root, slope near it, True) of a decreasing residual; the root is the last argument that was evaluated.

    The root is found by a bracketed secant. If the residual jumps over zero, the result is the side of the jump with
    the smaller residual, and False.

    Args:
        piece: Substep to solve, the first argument of `residual`.
        start: First guess.
        slope: Slope of the residual near the root, below zero; -1 if unknown.
    """
    force, error = start, residual(piece, start)
    best, least = force, abs(error)
    largest = max(abs(force), abs(force + error))
    low, high = -inf, inf
    for count in range(_LARGEST_COUNT):
        if abs(error) <= _CLOSE * largest:
            return force, slope, True
        if error > 0.0:
            low = max(low, force)
        else:
            high = min(high, force)
        candidate = force - error / slope
        if high - low == inf:
            candidate = candidate if candidate != force else force + error
        elif count > _SECANT_STEPS or not low < candidate < high:
            candidate = 0.5 * (low + high)
        if candidate in (low, high):
            break
        change = residual(piece, candidate) - error
        slope = min(change / (candidate - force), _FLATTEST)
        force, error = candidate, error + change
        largest = max(largest, abs(force))
        if abs(error) < least:
            best, least = force, abs(error)
    if force != best:
        residual(piece, best)
    return best, -1.0, least <= _JUMP * largest


DETENT, RIPPLE, FALLING, BRISTLE = 0, 1, 2, 3
"""Kinds of `Effort`: of cogging, torque_ripple, stribeck_friction and lugre_friction."""
_TURN: Final = 2.0 * pi


@dataclass(frozen=True, slots=True)
class Effort:
    """One force of any kind; parameters that a kind does not have are 0."""

    kind: int
    amplitude: float = 0.0  # of a detent [N or N*m], of a ripple as a part of the torque
    pitch: float = 1.0  # [m or rad]
    phase: float = 0.0  # [rad]
    kinetic: float = 0.0  # friction of a fast slide; of FALLING the friction that another part exerts [N or N*m]
    static: float = 0.0  # friction at which it breaks away [N or N*m]
    stribeck_velocity: float = 1.0  # [m/s or rad/s]
    bristle_stiffness: float = 0.0  # [N/m or N*m/rad]
    bristle_damping: float = 0.0  # [N*s/m or N*m*s/rad]
    viscous: float = 0.0  # [N*s/m or N*m*s/rad]


@dataclass(slots=True)
class Bristle:
    """State of a bristle force."""

    deflection: float = 0.0  # [m or rad]


def mean_force(
    effort: Effort, bristle: Bristle, position: float, travel: float, duration: float, torque: float
) -> float:
    """Return the mean force [N or N*m] over a substep.

    Args:
        effort: The force.
        bristle: State at the start of the substep.
        position: Position at the start [m or rad].
        travel: Displacement in the substep [m or rad].
        duration: Duration of the substep [s].
        torque: Mean torque of the motor over the substep [N or N*m].
    """
    if effort.kind == DETENT:
        return -effort.amplitude * mean_sine(_TURN / effort.pitch, effort.phase, position, travel)
    if effort.kind == RIPPLE:
        return torque * effort.amplitude * mean_sine(_TURN / effort.pitch, effort.phase, position, travel)
    if effort.kind == FALLING:
        return falling_friction(effort, travel, duration)
    return bristle_force(effort, bristle, travel, duration)


def mean_sine(wave_number: float, phase: float, position: float, travel: float) -> float:
    """Return the mean of sin(wave_number * q + phase) from `position` to `position + travel`, without cancellation."""
    half = 0.5 * wave_number * travel
    spread = sin(half) / half if half != 0.0 else 1.0
    return sin(wave_number * (position + 0.5 * travel) + phase) * spread


def falling_friction(effort: Effort, travel: float, duration: float) -> float:
    """Return the friction in excess of kinetic friction at the mean velocity [N or N*m]."""
    if travel == 0.0:
        return 0.0
    ratio = travel / (duration * effort.stribeck_velocity)
    return -copysign((effort.static - effort.kinetic) * exp(-ratio * ratio), travel)


def bristle_force(effort: Effort, bristle: Bristle, travel: float, duration: float) -> float:
    """Return the mean friction of bristles [N or N*m]."""
    if duration == 0.0:
        return -effort.bristle_stiffness * bristle.deflection
    end, mean = bent(effort, bristle, travel, duration)
    bending = effort.bristle_damping * (end - bristle.deflection) / duration
    return -(effort.bristle_stiffness * mean + bending + effort.viscous * travel / duration)


def bend(effort: Effort, bristle: Bristle, travel: float, duration: float) -> None:
    """Update the bending of the bristle over a substep."""
    if effort.kind == BRISTLE:
        bristle.deflection = bent(effort, bristle, travel, duration)[0]


def bent(effort: Effort, bristle: Bristle, travel: float, duration: float) -> tuple[float, float]:
    """Return the bristle's deflection after a substep, and its mean, at a constant velocity [m or rad]."""
    deflection = bristle.deflection
    if travel == 0.0:
        return deflection, deflection
    ratio = travel / (duration * effort.stribeck_velocity)
    level = effort.kinetic + (effort.static - effort.kinetic) * exp(-ratio * ratio)
    sliding = copysign(level / effort.bristle_stiffness, travel)
    lengths = abs(travel) * effort.bristle_stiffness / level  # travel by the length in which the rest falls to 1/e
    lost = -expm1(-lengths)
    end = deflection + (sliding - deflection) * lost
    return end, sliding + (deflection - sliding) * (lost / lengths if lengths != 0.0 else 1.0)


def held_energy(effort: Effort, bristle: Bristle, position: float) -> float:
    """Energy stored in a force [J]; 0 at the middle of a detent and for a relaxed bristle."""
    if effort.kind == DETENT:
        wave_number = _TURN / effort.pitch
        half = sin(0.5 * (wave_number * position + effort.phase))
        return 2.0 * effort.amplitude / wave_number * half * half
    return 0.5 * effort.bristle_stiffness * bristle.deflection**2


class EffortForce(NonlinearForce):
    """An `Effort` as a part of a plant.

    Args:
        effort: The force.
        account: Energy account of its work; None if the work is stored.
    """

    def __init__(self, effort: Effort, account: Account | None) -> None:
        self.effort, self.account = effort, account
        self.state_names = ("bristle_deflection",) if effort.kind == BRISTLE else ()
        self._bristle = Bristle()

    def reset(self) -> None:
        """Relax the bristle."""
        self._bristle.deflection = 0.0

    def force(self, position: float, travel: float, duration: float, torque: float) -> float:
        """Return the mean force [N or N*m] over a substep that starts at `position` and moves by `travel`."""
        return mean_force(self.effort, self._bristle, position, travel, duration, torque)

    def commit(self, position: float, travel: float, duration: float, torque: float) -> None:
        """Update the state at the end of a substep."""
        bend(self.effort, self._bristle, travel, duration)

    def stored(self, position: float) -> float:
        """Return the energy stored in it [J]."""
        return held_energy(self.effort, self._bristle, position)
