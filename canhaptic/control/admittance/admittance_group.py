"""Several admittance displays with one account: energy that entered at one axis may leave at another.

Each axis has its own drive, so that the margins of `velocity_loop` add up: W = E - sum V_i, and the losses of all
queued commands add up too. A request that does not fit is reduced in all axes by one factor, so that it
keeps its direction: the loss is convex in the factor, hence the chord between a factor that fits and one that does not
gives a larger one that fits.
"""

from collections.abc import Sequence
from math import sqrt
from typing import ClassVar, Final

from canhaptic.control.admittance.admittance_environment import (
    AdmittanceMotion,
    display_memory,
    limited,
    motion_settings,
    send,
    sent,
    whole,
)
from canhaptic.control.admittance.force_evidence import (
    ForceEvidence,
    LateMargin,
    contradiction,
    fall,
    margin_memory,
    momentum_check,
    moved_hold,
    oldest,
    rise,
)
from canhaptic.control.admittance.port import AdmittanceProperties, BookedHold, Port, port_settings, reopen
from canhaptic.control.admittance.sampled_group import AdmittanceGroup, GroupAxis, GroupMotion, require_alike
from canhaptic.control.admittance.velocity_loop import (
    GuardedAdmittanceParameters,
    LoopState,
    gained,
    loop_settings,
    loss_of_skip,
    loss_under_way,
    lost_unseen,
    may_limit,
    reserve,
)
from canhaptic.control.balance import AT_REST, Branch, Certificate, EnergyBalance
from canhaptic.control.multi_axis.group_controller import GroupBalance, group_at_rest
from canhaptic.control.passivity.stepped import settle
from canhaptic.errors import ForceContradictedError, ParameterError
from canhaptic.kernels import list_of_zeros
from canhaptic.units import Parameters

_CHORDS: Final = 6  # each leaves only a part of the gap to the largest factor
_CLOSE: Final = 0.999  # of the budget used: near enough


class _GroupAxis(GroupAxis):
    """Settings and state of one axis of a group."""

    def __init__(
        self,
        environment: GroupMotion,
        place: int,
        parameters: GuardedAdmittanceParameters,
        properties: AdmittanceProperties,
    ) -> None:
        self.loop_settings = loop_settings(parameters, properties)
        lag = self.loop_settings.mass / self.loop_settings.gain_least
        self.port_settings = port_settings(properties)
        self.motion_settings = motion_settings(environment.of_axis(place), properties, lag)
        self.port, self.motion, self.loop = Port(), AdmittanceMotion(), LoopState()
        kept = self.loop_settings.delay + self.loop_settings.losses + 2
        self.memory = display_memory(self.port_settings, self.motion_settings, kept, list_of_zeros)
        self.leads = list_of_zeros(properties.latency + 1)
        self._evidence = ForceEvidence(properties.latency)
        self._check = momentum_check(parameters, self.port_settings, self.loop_settings)

    def begin(self, position: float, force: float) -> None:
        """Take the first sample."""
        super().begin(position, force)
        if self._check is not None:
            self._check.begin(position, force, 0.0)

    def fall(self, change: float) -> None:
        """Apply a lower bound on the change of the margin in the hold that ended [J]."""
        self._evidence.fall(change)

    def contradiction(self, of: str, hold: BookedHold, force: float, *, is_first: bool) -> str:
        """Reason why force and motion cannot both be right, or "". Call it at every SYNC, after `send`.

        Args:
            of: The sensor.
            hold: The hold as it was booked.
            force: Received force [N or N*m].
            is_first: Whether samples were lost before this one.
        """
        evidence, loop = self._evidence, self.loop_settings
        evidence.book(loop, hold, self.port_settings.acceleration)
        if evidence.is_contradicted:
            return contradiction(of, evidence.by_force, evidence.by_encoder)
        if self._check is None:
            return ""
        if is_first:
            self._check.begin(self.port.position, force, self.loop.lead)
            return ""
        moved = moved_hold(loop, self.motion, self.memory.commands, hold.moved, self.loop.lead)
        found = self._check.take(moved, force)
        return "" if found is None else found.text(of)

    def change(self, moved: float | None) -> float:
        """Lower bound on the change of the margin in the hold that ended [J]; `moved` is None if no sample came."""
        commands = self.memory.commands
        if moved is not None:
            return gained(self.loop_settings, self.loop.lead, commands, self.motion, moved)
        if self.loop_settings.integral == 0.0:
            return -lost_unseen(self.loop_settings, commands, self.motion)
        return 0.0 if self.port.missed else -self.used()

    def change_of_skip(self, skipped: int) -> tuple[float, float]:
        """Return the change of the margin in the first and in each further hold where SYNCs are skipped [J]."""
        loop, motion, commands = self.loop_settings, self.motion, self.memory.commands
        if loop.integral > 0.0:
            return -loss_of_skip(loop, self.loop.lead, commands, motion, skipped), 0.0
        lost = -lost_unseen(loop, commands, motion)
        return lost, lost

    def used(self) -> float:
        """Largest loss of the margin by all queued commands [J]."""
        return loss_under_way(self.loop_settings, self.loop.lead, self.memory.commands, self.motion)

    def acted(self) -> float:
        """Displacement commanded in the hold that ended [m or rad]."""
        return sent(self.motion, self.memory.commands, self.loop_settings.delay) * self.port_settings.sample_time

    def limit(self, request: float, position: float, velocity: float) -> float:
        """Return the nearest command that the limits of the axis allow [m/s or rad/s]."""
        request = limited(self.motion_settings, self.motion, self.memory.commands, request, position, velocity)
        return whole(self.motion_settings, request)

    def replace_newest(self, speed: float) -> None:
        """Replace the newest command."""
        self.memory.commands[self.motion.newest] = self.motion.speed = speed


class GuardedAdmittanceGroup(AdmittanceGroup[_GroupAxis]):
    """A mass on several axes, with the certificate of their velocity loops; a `GroupController`.

    Args:
        environment: Environment to render.
        parameters: Parameters of every axis; masses are over-estimates of the largest.
        properties: Declared properties of each axis; sample time, delay and latency are the same for all.

    Attributes:
        axes: Number of axes.
        energy_resolution: Uncertainty of the energy of all axes [J]; its lower end is booked.

    Raises:
        ParameterError: Parts do not fit together, or a hand is declared.
    """

    parameters_type: ClassVar[type[Parameters]] = GuardedAdmittanceParameters
    is_certified: ClassVar[bool] = True

    def __init__(
        self,
        environment: GroupMotion,
        parameters: GuardedAdmittanceParameters,
        properties: Sequence[AdmittanceProperties],
    ) -> None:
        require_alike(properties)
        for key in ("largest_hand_force", "hand_stiffness"):
            if getattr(parameters, key):
                raise ParameterError(
                    f"guarded: {key}: got {getattr(parameters, key):g}, expected 0 for several axes: "
                    "such a hand is proved for one axis only"
                )
        environment.require(len(properties))
        self.axes = len(properties)
        self._environment, self._parameters, self._properties = environment, parameters, tuple(properties)
        self._time, self._allowance = properties[0].sample_time, parameters.energy_allowance
        self.max_consecutive_losses, self.energy_allowance = parameters.max_consecutive_losses, self._allowance
        self.reset()

    def reset(self) -> None:
        """Return to the initial state; see `GroupController`."""
        self._each = [
            _GroupAxis(self._environment, place, self._parameters, of) for place, of in enumerate(self._properties)
        ]
        self._margin = LateMargin()
        self._memory = margin_memory(self._properties[0].latency, list_of_zeros)
        self._h_s = self._surplus = self._taken = 0.0
        uneven = any(of.jitter > 0.0 for of in self._properties)  # the integral of the drive is then unknown
        self._is_unsure, self._started = uneven and self._parameters.integral_gain > 0.0, False
        self._last = group_at_rest(self.axes)

    def sample_lost(self) -> GroupBalance:
        """Answer a SYNC at which the sample of an axis was lost: no command; see `GroupController`."""
        speeds = (0.0,) * self.axes
        if self._started:
            self._let_pass([axis.change(None) for axis in self._each])
            for axis in self._each:
                send(axis.motion, axis.memory.commands, 0.0)
            self._watch_limit()
        last = self._last.account
        account = AT_REST._replace(h_s=last.h_s, h_dis=last.h_dis, branch=Branch.HELD.value)
        return GroupBalance(speeds, account, speeds)

    def lasted(self, periods: float) -> None:
        """Account for skipped SYNCs: no command was sent, and the queued ones acted longer."""
        skipped = round(periods) - 1
        if not self._started:
            return
        self._is_unsure = self._is_unsure or any(
            axis.port.missed and axis.loop_settings.integral for axis in self._each
        )
        changes = [axis.change_of_skip(skipped) for axis in self._each]
        for number in range(skipped):
            self._let_pass([change[min(number, 1)] for change in changes])
        self._watch_limit()

    def _let_pass(self, changes: Sequence[float]) -> None:
        """Account for a hold without a sample, in which the margin changed by at least these amounts [J]."""
        for axis in self._each:
            axis.loop.lead += axis.acted()
            axis.port.missed += 1
        self._fall(changes)

    def _answer(self, positions: Sequence[float], forces: list[float]) -> GroupBalance:
        is_first = bool(self._each[0].port.missed)
        holds, h_i = self._take(positions, forces)
        before = [axis.motion.speed for axis in self._each]
        velocities = [hold.moved / hold.elapsed for hold in holds]
        request = self._environment.speeds_after(before, forces, list(positions), self._time)
        limits = zip(self._each, request, positions, velocities, strict=True)
        certificate = self._send([axis.limit(speed, position, velocity) for axis, speed, position, velocity in limits])
        self._watch_limit()
        if self._is_unsure:
            certificate = Certificate.NONE.value
        else:
            self._require_agreement(holds, forces, is_first=is_first)
        account = self._settle(h_i, before, velocities, certificate)
        commands = tuple(axis.motion.speed for axis in self._each)
        apart = (h_i - sum(hold.energy for hold in holds)) / self.axes  # known by the encoders: of no axis alone
        return GroupBalance(commands, account, tuple(hold.energy + apart for hold in holds))

    def _take(self, positions: Sequence[float], forces: Sequence[float]) -> tuple[list[BookedHold], float]:
        """Book the hold that ended on every axis and bring the margin up to date; return (holds, h_i [J])."""
        missed = self._each[0].port.missed
        holds = [
            axis.book(position, force) for axis, position, force in zip(self._each, positions, forces, strict=True)
        ]
        moved = [None if missed else hold.moved for hold in holds]
        changes = [axis.change(way) for axis, way in zip(self._each, moved, strict=True)]
        if missed and self._each[0].loop_settings.integral > 0.0:
            changes = [0.0] * self.axes  # all is deducted by now
        for axis, hold in zip(self._each, holds, strict=True):
            axis.loop.lead += axis.acted() - hold.moved
            axis.loop.velocity, axis.loop.holds = hold.moved / hold.elapsed, missed + 1
        self._fall(changes)
        energy = sum(hold.energy for hold in holds)
        if self._is_unsure or not holds[0].is_booked:
            return holds, energy
        then, free = oldest(self._margin, self._memory), self._h_s - self._surplus
        kept = [
            reserve(axis.loop_settings, axis.leads[then], hold.speed)
            for axis, hold in zip(self._each, holds, strict=True)
        ]
        rise(self._margin, self._memory, then, free + energy - sum(kept), self._taken)
        proved = self._memory.before[then] - self._taken
        if proved <= free + energy:
            return holds, energy
        for axis in self._each:
            reopen(axis.port)
        return holds, proved - free

    def _require_agreement(self, holds: Sequence[BookedHold], forces: Sequence[float], *, is_first: bool) -> None:
        """Compare every force with the motion, axis by axis: each drive has its own loop.

        Raises:
            ForceContradictedError: They do not agree.
        """
        for number, (axis, hold, force) in enumerate(zip(self._each, holds, forces, strict=True), 1):
            text = axis.contradiction(f"force sensor of motor axis {number}", hold, force, is_first=is_first)
            if text:
                self.reset()
                raise ForceContradictedError(text)

    def _fall(self, changes: Sequence[float]) -> None:
        fall(self._margin, self._memory, sum(changes), self._taken)
        for axis, change in zip(self._each, changes, strict=True):
            axis.fall(change)
            axis.leads[self._margin.place] = axis.loop.lead

    def _send(self, request: Sequence[float]) -> int:
        """Send the largest certified part of the requested speeds; return the certificate that reduced it."""
        for axis, speed in zip(self._each, request, strict=True):
            send(axis.motion, axis.memory.commands, speed)
        budget, used = self._margin.known + self._allowance, sum(axis.used() for axis in self._each)
        if used <= budget:
            return Certificate.EXACT.value
        low, high, above = 0.0, 1.0, used
        below = self._used_at(request, 0.0)
        for _ in range(_CHORDS if below <= budget else 0):
            part = low + (high - low) * (budget - below) / (above - below)
            used = self._used_at(request, part)
            if used > budget:  # by rounding
                high, above = part, used
                continue
            low, below = part, used
            if used >= _CLOSE * budget:
                break
        self._used_at(request, low)
        return Certificate.VELOCITY_LOOP.value

    def _used_at(self, request: Sequence[float], part: float) -> float:
        """Energy used [J] with a part of the requested speeds as the newest commands."""
        for axis, speed in zip(self._each, request, strict=True):
            axis.replace_newest(whole(axis.motion_settings, part * speed))
        return sum(axis.used() for axis in self._each)

    def _watch_limit(self) -> None:
        """Determine whether a drive with an integral may reach its torque limit: nothing is certified then."""
        for axis in self._each:
            if axis.loop_settings.integral > 0.0 and not self._is_unsure:
                self._is_unsure = may_limit(axis.loop_settings, axis.loop, axis.motion.speed, axis.port.missed)

    def _settle(self, h_i: float, before: list[float], velocities: Sequence[float], certificate: int) -> EnergyBalance:
        """Dissipate and leak what neither the mass nor the drives can give back; return the account."""
        environment, under_way = self._environment, sum(axis.used() for axis in self._each)
        speeds, carried = [axis.motion.speed for axis in self._each], under_way
        for axis, velocity in zip(self._each, velocities, strict=True):
            fastest = abs(velocity) + axis.port_settings.acceleration * self._time
            carried += reserve(axis.loop_settings, axis.loop.lead, fastest)
        ceiling = max(environment.stored(speeds), environment.stored(before), carried)
        slack = self._margin.known + self._allowance - under_way
        lost = environment.lost(before, self._time)
        h_s, surplus, h_r, deficit, leak, paid = settle(self._h_s + h_i, self._surplus, lost, ceiling, slack)
        taken = h_r + leak - paid
        self._margin.known -= taken
        self._taken += taken
        self._h_s, self._surplus = h_s, surplus
        is_still = not any(speeds) and not any(before)
        branch = Branch.DEPLETED if deficit > 0.0 else Branch.FREE if is_still else Branch.EXACT
        norm = sqrt(sum(speed * speed for speed in speeds))
        return EnergyBalance(
            norm, h_i, 0.0, h_i, h_r, h_s, surplus, 0.0, deficit, leak, paid, branch.value, environment.damping,
            certificate, 0.0,
        )  # fmt: skip
