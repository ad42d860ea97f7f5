"""Check of the measured force of an admittance display against the momentum of what its drive moves.

Encoder and commands give the momentum, up to the declared bounds of the drive; the sensor gives the force: D8 of
`docs/theory/commands_of_a_display.md`. A constant offset o of the sensor gives out o times the distance moved until it
is noticed, and never more than o times the range between the position limits. If the friction of the drive is unknown,
an offset of the sensor looks like a push of the hand. So nothing is compared without declared friction, nor if the
torque of the drive may have been at its limit.
"""

from collections import deque
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from canhaptic.control.admittance.port import AdmittanceProperties
from canhaptic.control.admittance.velocity_loop import GuardedAdmittanceParameters, VelocityLoop

_HALF: Final = 0.03  # H [s]
_FEWEST: Final = 8  # holds in it


class MovedHold(NamedTuple):
    """Measured motion and velocity command of one hold."""

    moved: float  # [m or rad]
    command: float  # that acted [m/s or rad/s]
    uncertainty: float  # largest difference of the command that acted, where RPDOs were lost [m/s or rad/s]
    lead: float  # at its end: commanded less actual displacement [m or rad]


class Disagreement(NamedTuple):
    """Mean of the measured force, outside the range that the motion allows [N or N*m]."""

    shown: float
    low: float
    high: float
    over: float  # time that the means are taken over [s]

    def text(self, of: str = "force sensor") -> str:
        """Return the message of the disagreement, with the remedy."""
        return (
            f"{of}: it shows {self.shown:.3g} on average over {self.over:g} s, but encoder and commands put the force "
            f"between {self.low:.3g} and {self.high:.3g} [N or N*m]: its offset, sign or scale is wrong, it is frozen, "
            "commands do not reach the drive, or drive_mass, loop_gain, drive_friction or drive_damping is wrong; the "
            "velocity is zero; check sensor, bus and drive [FORCE_CONTRADICTED]"
        )


@dataclass(slots=True)
class _Half:
    """Sums over the holds of one half of the triangular weight: unweighted, and with the rising weight."""

    begin: float  # position [m or rad]
    sums: list[float] = field(default_factory=lambda: [0.0] * 4)  # of force, v - r, lead and uncertainty of each hold
    rising: list[float] = field(default_factory=lambda: [0.0] * 4)
    is_limited: bool = False
    command_change: float = 0.0  # sum of abs(change of the command) [m/s or rad/s]
    force_change: float = 0.0
    largest_command: float = 0.0
    largest_force: float = 0.0


@dataclass(slots=True)
class _Memory:
    """State of a momentum check, kept from SYNC to SYNC."""

    position: float = 0.0  # at the end of the last hold that was taken [m or rad]
    force: float = 0.0  # shown there
    command: float = 0.0
    lead: float = 0.0
    holds: int = 0  # in the half that is being filled
    filling: _Half = field(default_factory=lambda: _Half(0.0))
    full: _Half | None = None
    waiting: deque[MovedHold] = field(default_factory=deque)  # holds whose force has not come


class MomentumCheck:
    """Compares the measured force with the momentum of one axis.

    Args:
        parameters: Declared properties of the drive.
        port: Declared properties of the force sensor.
        loop: Declared velocity loop of the drive.
    """

    def __init__(self, parameters: GuardedAdmittanceParameters, port: AdmittanceProperties, loop: VelocityLoop) -> None:
        self._port, self._loop, self._spread = port, loop, parameters.spread
        self._friction, self._damping = parameters.drive_friction or 0.0, parameters.drive_damping
        self._holds = max(_FEWEST, round(_HALF / port.sample_time))
        self._half = self._holds * port.sample_time
        self.begin(0.0, 0.0, 0.0)

    def begin(self, position: float, force: float, lead: float) -> None:
        """Restart the check at the first sample, or at the first one after lost samples."""
        self._memory = _Memory(position, force, 0.0, lead, filling=_Half(position))

    def take(self, hold: MovedHold, force: float) -> Disagreement | None:
        """Add the hold that ended and the received force; return a disagreement, or None.

        Args:
            hold: Motion and command of the hold that ended.
            force: Measured force [N or N*m]; it belongs to a hold `latency` samples ago.
        """
        memory = self._memory
        memory.waiting.append(hold)
        if len(memory.waiting) <= self._port.latency:
            memory.force = force
            return None
        self._add(memory.waiting.popleft(), force)
        if memory.holds < self._holds:
            return None
        first, second = memory.full, memory.filling
        memory.full, memory.filling, memory.holds = second, _Half(memory.position), 0
        if first is None or first.is_limited or second.is_limited:
            return None
        return self._compared(first, second)

    def _add(self, hold: MovedHold, force: float) -> None:
        """Add a hold to the half of the triangular weight that is being filled."""
        memory, port = self._memory, self._port
        time = port.sample_time
        half, velocity = memory.filling, hold.moved / time
        memory.holds += 1
        rise = (memory.holds - 0.5) / self._holds
        mean, uncertainty = self._mean_force(force, memory.force)
        loose = uncertainty + self._loop.gain * hold.uncertainty + self._damping * abs(velocity)
        slip, lead = velocity - hold.command, 0.5 * (memory.lead + hold.lead)
        for place, value in enumerate((mean, slip, lead, loose)):
            half.sums[place] += value
            half.rising[place] += rise * value
        torque = self._loop.gain * (abs(slip) + 0.5 * port.handle_acceleration * time + port.encoder_count / time)
        torque += self._loop.integral * (abs(lead) + port.encoder_count + abs(slip) * time)
        half.is_limited = half.is_limited or torque >= self._loop.torque_limit
        half.command_change += abs(hold.command - memory.command)
        half.force_change += abs(force - memory.force)
        half.largest_command = max(half.largest_command, abs(hold.command))
        half.largest_force = max(half.largest_force, abs(force))
        memory.position += hold.moved
        memory.force, memory.command, memory.lead = force, hold.command, hold.lead

    def _mean_force(self, force: float, before: float) -> tuple[float, float]:
        """Return the mean force of a hold, and its uncertainty without the error of a sample [N or N*m]."""
        port, change, uncertainty = self._port, force - before, 0.0
        if not port.is_mean:
            length = port.sample_time * (1.0 + port.jitter)
            uncertainty = max(0.0, port.force_slew * port.force_slew * length * length - change * change) / (
                4.0 * port.force_slew * length
            )
            force = 0.5 * (force + before)
        return force + change * port.lag / port.sample_time, uncertainty

    def _compared(self, first: _Half, second: _Half) -> Disagreement | None:
        """Compare measured and expected mean force over the triangular weight; return a disagreement, or None."""
        holds, loop = self._holds, self._loop
        halves = zip(first.rising, second.sums, second.rising, strict=True)
        force, slip, lead, loose = [(rising + whole - falling) / holds for rising, whole, falling in halves]
        bent = (self._memory.position - 2.0 * second.begin + first.begin) / (self._half * self._half)
        terms = (
            (loop.mass * (1.0 - self._spread), loop.mass, bent),
            (loop.gain_least, loop.gain, slip),
            (loop.integral_least, loop.integral, -lead),
        )
        low = sum(min(least * term, most * term) for least, most, term in terms)
        high = sum(max(least * term, most * term) for least, most, term in terms)
        margin = loose + self._margin(first, second)
        if low - margin <= force <= high + margin:
            return None
        return Disagreement(force, low - margin, high + margin, 2.0 * self._half)

    def _margin(self, first: _Half, second: _Half) -> float:
        """Return the largest permitted difference of the mean forces, without each hold's uncertainty [N or N*m]."""
        port, loop, half = self._port, self._loop, self._half
        time = port.sample_time
        turned = time * time / (6.0 * half)
        margin = port.force_error * (1.0 + 4.0 * port.lag / half) + port.force_slew * turned + self._friction
        margin += self._damping * 0.25 * port.handle_acceleration * time
        margin += loop.gain * (port.handle_acceleration * turned + port.encoder_count / half)
        margin += loop.integral * (port.encoder_count + port.handle_acceleration * time * time / 8.0)
        margin += 2.0 * loop.mass * port.encoder_count / (half * half)
        if port.jitter:
            shift = port.jitter * time / half
            command = 2.0 * max(first.largest_command, second.largest_command)
            force = 2.0 * max(first.largest_force, second.largest_force)
            margin += shift * loop.gain * (command + first.command_change + second.command_change)
            margin += shift * (force + first.force_change + second.force_change)
        return margin


def momentum_check(
    parameters: GuardedAdmittanceParameters, port: AdmittanceProperties, loop: VelocityLoop
) -> MomentumCheck | None:
    """Return the momentum check; None if `drive_friction` is not declared or the drive's integral is unknown."""
    if parameters.drive_friction is None or (loop.integral > 0.0 and port.jitter > 0.0):
        return None
    return MomentumCheck(parameters, port, loop)
