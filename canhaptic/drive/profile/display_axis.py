"""An admittance display on any bus: force in the process data, velocity or position command out.

It runs in the same cycle as an axis in torque mode: its sample holds minus the hand's force in place of the torque of
an impedance display. Its start also sets the steepest ramps, zero offsets, and a quick stop that brakes. A class of a
bus derives from its own axis first, and then from `DisplayAxis`.
"""

from collections.abc import Callable
from math import inf
from typing import Final

from canhaptic.canopen import objects as od
from canhaptic.canopen.objects import Dictionary, is_writable
from canhaptic.drive.profile.admittance_parameters import AdmittanceParameters, ForceChannel
from canhaptic.drive.profile.bring_up import BringUp
from canhaptic.drive.profile.fitness import RAMPS, largest_value
from canhaptic.drive.profile.scaling import AxisScaling
from canhaptic.drive.profile.torque_axis import CycleRules, ObjectAccess, TorqueAxis
from canhaptic.drive.profile.torque_axis_parameters import ReadBack, TorqueAxisParameters
from canhaptic.drive.safety.limiter import TorqueLimiter
from canhaptic.drive.safety.link_policy import StopReason
from canhaptic.drive.safety.power_states import PowerState
from canhaptic.errors import ParameterError
from canhaptic.signals import Sample

_tuple: Final = tuple.__new__
_WRAP: Final = 1 << 32
_UNLIMITED_SPEED: Final = 1e9  # [m/s or rad/s] where the scene declares none, on the virtual bus only


class DisplayAxis(TorqueAxis):
    """A drive that follows velocities and reports forces; the arguments are those of `TorqueAxis`.

    Attributes:
        checks_rest: Whether the start refuses a sensor that shows more than `force.error` before the drive is enabled.

    Raises:
        ParameterError: The axis is not an admittance display.
    """

    stop_word = od.Controlword.QUICK_STOP

    def __init__(
        self, axis: TorqueAxisParameters, dictionary: Dictionary, sdo: ObjectAccess, rules: CycleRules,
        read_back: ReadBack, dry_run: bool = False,
    ) -> None:  # fmt: skip
        display = axis.admittance
        if display is None:
            raise ParameterError(f"{axis.name}: has no `admittance`; expected an admittance display")
        self.display: AdmittanceParameters = display
        self.force = ForceChannel(display.force, rules.sample_time)
        self.checks_rest = display.force.sampling != "impulse"  # a sum does not show the present force
        self._is_position = display.mode == "position"
        super().__init__(axis, dictionary, sdo, rules, read_back, dry_run)
        counts, speed = axis.counts_per_unit, axis.speed_limit or _UNLIMITED_SPEED
        of_position = 1.0 / (counts * rules.sample_time)
        self.command_quantum = of_position if self._is_position else 1.0 / (display.velocity_counts or counts)
        self.stop_time = round(display.stop_time * 1e9)
        self.limiter = TorqueLimiter(speed, rules.sample_time, display.acceleration_limit)
        # A handle overshoots its command, and the hand moves it besides
        self._largest_step = 2.0 * speed * rules.sample_time
        # `AxisScaling` takes per mille, and here counts of the command
        self.command_scaling = AxisScaling(counts, self.command_quantum * 1000.0, axis.direction)
        self._low = -inf if display.position_low is None else display.position_low
        self._high = inf if display.position_high is None else display.position_high
        if self._is_position:
            self.rest_text = "the position of the axis"

    @property
    def quantum(self) -> float:
        """Step of the force in its process data [N or N*m]."""
        return abs(self.display.force.per_count)

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

    def rests_at(self, target: int) -> bool:
        """Whether a target read from the drive is consistent with rest."""
        if not self._is_position:
            return target == 0
        if target in self._rest_targets:  # a hand may move the axis meanwhile
            return True
        # A handle may move by so much between two readings of its position
        return abs((target - self.position_counts + _WRAP // 2) % _WRAP - _WRAP // 2) <= (1 << 10)


class DisplayBringUp(BringUp):
    """Configures one drive that follows velocities."""

    _drive: DisplayAxis

    def _zero_torque(self) -> None:
        """Write a target at rest, the steepest ramps of the drive, zero offsets, and the quick stop."""
        with self.step("zero torque"):
            rest = self._sdo.read(od.POSITION_ACTUAL) if self._drive.display.mode == "position" else 0
        self._write_confirmed("zero torque", self._drive.axis.causality.target, 0, rest)
        for index in RAMPS:  # a ramp inside the drive changes the command behind the certificate's back
            self._write_unless_asked("ramps", index, largest_value(self._drive.dictionary, index))
        self._zero_offsets()
        steepest = largest_value(self._drive.dictionary, od.QUICK_STOP_DECELERATION)
        self._write_unless_asked("quick stop", od.QUICK_STOP_DECELERATION, steepest)
        self._write_unless_asked("quick stop", od.QUICK_STOP_OPTION, 2)  # along its ramp, then disabled

    def _write_unless_asked(self, step: str, index: int, value: int) -> None:
        """Write an object if the drive has it and the scene does not set it."""
        drive = self._drive
        if is_writable(drive.dictionary, index, 0) and (index, 0) not in drive.axis.written_objects:
            self._write_confirmed(step, index, 0, value)

    def check_rest(self) -> None:
        """Refuse a sensor that shows a force while nothing pushes: an offset alone would move the handle."""
        drive = self._drive
        if not drive.checks_rest:
            return
        force, declared = drive.force, drive.display.force
        shown, unit = force.of(drive.reported_per_mille), "N" if drive.axis.unit == "m" else "N*m"
        if not -declared.error <= shown <= declared.error:
            wanted = f"at most force.error ({declared.error:g} {unit}), with no hand on the handle"
            raise self.refusal("force at rest", f"{shown:.4g} {unit} before the drive is enabled", wanted)
