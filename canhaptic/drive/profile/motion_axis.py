"""One axis in cyclic synchronous velocity or position mode: forces in, velocities out. Knows objects, no frames.

It runs in the same cycle as an axis in torque mode: its sample holds minus the hand's force in place of the torque. A
class of a bus derives from its own axis first, and then from `MotionAxis`.
"""

from collections.abc import Callable
from math import inf
from typing import Final, cast

from canhaptic.canopen import objects as od
from canhaptic.canopen.objects import Dictionary
from canhaptic.drive.profile.motion_parameters import ForceChannel, MotionParameters
from canhaptic.drive.profile.scaling import AxisScaling
from canhaptic.drive.profile.torque_axis import CycleRules, ObjectAccess, TorqueAxis
from canhaptic.drive.profile.torque_axis_parameters import ReadBack, TorqueAxisParameters
from canhaptic.drive.safety.limiter import TorqueLimiter
from canhaptic.drive.safety.link_policy import StopReason
from canhaptic.drive.safety.power_states import PowerState
from canhaptic.signals import Sample

_tuple: Final = tuple.__new__
_WRAP: Final = 1 << 32
_UNLIMITED_SPEED: Final = 1e9  # [m/s or rad/s] where the scene declares none, on the virtual bus only


class MotionAxis(TorqueAxis):
    """A drive that follows velocities and shows forces; the arguments are those of `TorqueAxis`."""

    stop_word = od.Controlword.QUICK_STOP

    def __init__(
        self, axis: TorqueAxisParameters, dictionary: Dictionary, sdo: ObjectAccess, rules: CycleRules,
        read_back: ReadBack, dry_run: bool = False,
    ) -> None:  # fmt: skip
        self._given = given = cast(MotionParameters, axis.admittance)
        self.force = ForceChannel(given.force, rules.sample_time)
        self._is_position = given.mode == "position"
        super().__init__(axis, dictionary, sdo, rules, read_back, dry_run)
        self.checks_rest = given.force.sampling != "impulse"  # a sum does not show the present force
        counts, speed = axis.counts_per_unit, axis.speed_limit or _UNLIMITED_SPEED
        self.command_quantum = given.command_quantum(counts, rules.sample_time)
        self.stop_time = round(given.stop_time * 1e9)
        self.limiter = TorqueLimiter(speed, rules.sample_time, given.acceleration_limit)
        # A handle overshoots its command, and the hand moves it besides
        self._largest_step = 2.0 * speed * rules.sample_time
        # `AxisScaling` takes per mille, and here counts of the command
        self.command_scaling = AxisScaling(counts, self.command_quantum * 1000.0, axis.direction)
        self._low = -inf if given.position_low is None else given.position_low
        self._high = inf if given.position_high is None else given.position_high
        if self._is_position:
            self.rest_text = "the position of the axis"

    @property
    def quantum(self) -> float:
        """Step of the force in its process data [N or N*m]."""
        return abs(self._given.force.per_count)

    def reset(self) -> None:
        """Clear everything received and commanded."""
        super().reset()
        self.force.reset()
        self._target = 0
        self._rest_targets: tuple[int, ...] = ()  # the last two that were sent while the drive was not enabled

    def sample(self, sync_index: int, periods: int = 1, *, is_whole: bool = True) -> Sample:
        """Return the sample of the SYNC just answered, else the last one, marked as old; see `TorqueAxis.sample`."""
        if not (self.is_complete and is_whole):
            return super().sample(sync_index, periods, is_whole=is_whole)
        self._periods += periods
        self._is_late = periods > 1
        self.longest_gap = max(self.longest_gap, periods)
        self.policy.on_tpdo()
        statusword, counts, shown = self._values
        position, last = self.scaling.position(counts), self._last
        periods, self._periods = self._periods, 0
        if last.sync_index >= 0:
            self._step = (position - last.position) / periods
            self.longest_hold = max(self.longest_hold, periods)
            if self._contest is not None:
                self._settle_contest(self._contest, abs(position - last.position), abs(self.force.of(shown)))
        force = self.force.take(shown, periods)
        self._last = sample = _tuple(Sample, (sync_index, position, -force, statusword, True))
        return sample

    def fault(self, now: int) -> StopReason:
        """Return why the rig must stop because of this drive; NONE without a reason."""
        if self.force.is_wrong:
            return StopReason.FORCE_RANGE if self.force.is_beyond_range else StopReason.FORCE_FROZEN
        return super().fault(now)

    def command_per_mille(self, torque: float) -> int:
        """Command in counts for a requested velocity [m/s or rad/s]; limited like a torque.

        At a position limit no velocity leads further towards it.

        Raises:
            ControlError: The velocity is not finite.
        """
        policy, limiter, position = self.policy, self.limiter, self._last.position
        if (policy.missed or self._is_late) and torque - torque == 0.0:
            held = limiter.last if not policy.missed else self._held if policy.is_held else 0.0
            torque = max(min(held, 0.0), min(max(held, 0.0), torque))
        if (position >= self._high and torque > 0.0) or (position <= self._low and torque < 0.0):
            torque = 0.0
        torque = limiter.limit(torque, 0.0)
        return self.command_scaling.torque_per_mille(torque, limiter.low, limiter.high)

    def _send(self, send: Callable[[int], None], command: int) -> None:
        """Send a command in the way of the bus; in mode 8 the target position advances by it; raise LinkError."""
        if not self._is_position:
            return send(command)
        rests = self.state is not PowerState.OPERATION_ENABLED
        begin = self.position_counts if rests else self._target
        target = (begin + command + _WRAP // 2) % _WRAP - _WRAP // 2
        send(target)
        if rests:
            self._rest_targets = (self._target, begin)
        self._target = target  # only what was sent: the next command adds to it

    def rest_target(self) -> int:
        """Return the target of a drive at rest: a velocity of 0, or the present position; raise SdoError."""
        return self.sdo.read(od.POSITION_ACTUAL) if self._is_position else 0

    def rest_objection(self) -> tuple[str, str] | None:
        """Return the force that is shown while nothing pushes: an offset alone would move the handle."""
        declared, unit = self._given.force, "N" if self.axis.unit == "m" else "N*m"
        shown = self.force.of(self.reported_per_mille)
        if not self.checks_rest or -declared.error <= shown <= declared.error:
            return None
        wanted = f"at most force.error ({declared.error:g} {unit}), with no hand on the handle"
        return f"{shown:.4g} {unit} before the drive is enabled", wanted

    def rests_at(self, target: int) -> bool:
        """Whether a target read from the drive is consistent with rest."""
        if not self._is_position:
            return target == 0
        if target in self._rest_targets:  # a hand may move the axis meanwhile
            return True
        # A handle may move by so much between two readings of its position
        return abs((target - self.position_counts + _WRAP // 2) % _WRAP - _WRAP // 2) <= (1 << 10)
