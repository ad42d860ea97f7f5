"""`guarded` for a group: the network keeps the state of its model, the energy account limits the torques together.

Of one axis with a spring and a damper it is `passivity.guarded` to rounding. Of several axes the account is one scalar;
efforts are compared in the norm in which every axis has its own damping cap, |f|^2 = sum(f_i^2 / cap_i), and are scaled
together, so that a limited force keeps its direction.
"""

import math
from collections.abc import Sequence
from typing import Annotated, ClassVar, Final

from canhaptic.control.balance import AT_REST, Branch, Certificate, EnergyBalance
from canhaptic.control.mechanisms.kinematics import Kinematics
from canhaptic.control.multi_axis.group_account import GroupAccount
from canhaptic.control.multi_axis.group_certificates import axes_of, taken_by_mover
from canhaptic.control.multi_axis.group_commands import EndedHold, GroupCommand, GroupCommands, Values, as_applied
from canhaptic.control.multi_axis.group_controller import GroupBalance, NetworkEnvironment, group_at_rest
from canhaptic.control.multi_axis.requested_efforts import GroupMotion, RequestedEfforts
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.control.recovery import Alpha, damping_cap, modulated_damping
from canhaptic.errors import ControlError, ParameterError
from canhaptic.units import Parameters, quantity

_CALM: Final = 0.7  # as in `passivity.guarded`, with the reasons
_LEAD_ROOM: Final = 1.75
_NO_CAP: Final = 1e12
_FADE: Final = 0.8
_GRID_TRIES: Final = 3
_GRID_BACK: Final = 0.99


class GuardedGroupParameters(Parameters):
    """What the certificates rest on. Mass and damping of the devices are properties of each axis's loop."""

    hand_force: Annotated[float, quantity("N", "N*m", ge=0.0)] | None = 0.0
    """Largest force with which the hand pulls each motor axis, Coriolis forces included (`bound`); None: not used."""
    hand_speed: Annotated[float, quantity("m/s", "rad/s", gt=0.0)] | None = None
    """Largest speed of every motor axis. None: the certificate is not used."""
    energy_allowance: Annotated[float, quantity("J", ge=0.0)] = 0.0
    """Energy that may be given out before any came in: the promise becomes sum(h_i) >= -energy_allowance."""
    alpha: Alpha = 0.0
    """Modulated damping per joule of surplus (eq. 19), always with its unit; 0 leaves the surplus standing."""
    prediction_holds: Annotated[float, quantity("count", ge=0.0, le=1.0)] = 0.5
    """Prediction beyond the delay, in holds: 0.5 aims at the middle of the hold."""
    max_consecutive_losses: Annotated[int, quantity("count", ge=0, le=16)] = 0
    """Consecutive cycles in which any axis may be without a new torque, or hold a part of it (`apart`); each costs
    stiffness. 0: all axes always apply together what was sent."""
    compiled: bool = False
    """Whether the network's equation runs compiled by numba (the extra `fast`); pays with masses, some seconds once."""


class GuardedGroup:
    """A network rendered as far as the certificates allow; see `GroupController`."""

    parameters_type: ClassVar[type[Parameters]] = GuardedGroupParameters

    def __init__(
        self,
        environment: NetworkEnvironment,
        kinematics: Kinematics,
        parameters: GuardedGroupParameters,
        loops: tuple[LoopProperties, ...],
    ) -> None:
        self._motion = GroupMotion(environment, kinematics, loops, parameters.compiled)
        self.axes = axes = kinematics.axes
        sample_time, delay = loops[0].sample_time, loops[0].delay
        self._known = known = axes_of(loops, parameters.hand_force, parameters.hand_speed)
        if not (known.by_hand or known.by_damping or known.path):
            raise ParameterError(
                "guarded group: got neither moving_mass of every axis with hand_force, nor device_damping of every "
                "axis, nor hand_speed, expected one of them; without any no torque can be certified"
            )
        self._sample_time, self._delay, self._alpha = sample_time, delay, parameters.alpha
        self._lead = parameters.prediction_holds + delay
        self._holds = delay + 1 + parameters.max_consecutive_losses
        self._caps = [min(_NO_CAP, damping_cap(delay, loop.moving_mass, sample_time)) for loop in loops]
        self._calm = _CALM / (sample_time * (0.5 + delay)) if known.by_hand else 0.0
        self._damped = [2.0 * b / (1 + delay) for b in known.damping] if known.by_damping else []
        self._path = known.path * (1 + delay)
        self._limits = [loop.torque_limit or math.inf for loop in loops]
        self._quanta = [loop.torque_quantum for loop in loops]
        self._quantised = any(self._quanta)
        self._commands = GroupCommands(axes, delay, self._limits)
        self.max_consecutive_losses, self._splits = (
            parameters.max_consecutive_losses,
            parameters.max_consecutive_losses > 0,
        )
        self.energy_allowance = parameters.energy_allowance
        self._account = GroupAccount(
            known, self._commands, parameters.energy_allowance, parameters.max_consecutive_losses
        )
        self.reset()

    def reset(self) -> None:
        """Forgets everything; see `GroupController`."""
        self._commands.reset()
        self._account.reset()
        self._motion.reset()
        self._was_engaged = False
        self._coming: tuple[Values, ...] = ()

    def hold(self) -> GroupBalance:
        """Repeats the last commands for want of a sample; see `GroupController`."""
        torques, account = self._commands.lose_hold(), self._account
        self._motion.skip()
        balance = AT_REST._replace(
            torque=math.hypot(*torques), h_s=account.h_s, h_dis=account.h_dis, branch=Branch.HELD.value,
            state=self._motion.first_state,
        )  # fmt: skip
        return GroupBalance(torques, balance, (0.0,) * self.axes)

    def step(self, positions: Sequence[float], torques_applied: Sequence[float]) -> GroupBalance:
        """Books the hold that ended; see `GroupController`."""
        applied = tuple(torques_applied)
        try:
            hold = self._commands.ended(tuple(positions), applied)
        except ControlError:
            self.reset()
            raise
        motion = self._motion
        if hold is None:
            self._account.reset()
            motion.begin(positions)
            self._coming = motion.carried(0, self._holds)
            return group_at_rest(self.axes)
        holds = 1 + len(hold.skipped)
        motion.follow(positions, hold.displacement, holds)
        carried = self._passed(holds)
        unsure = self._end(hold, applied, carried)
        interactions = tuple([-t * d for t, d in zip(applied, hold.displacement, strict=True)])
        supplied = -sum([taken_by_mover(applied, moved) for moved in carried])
        h_i = math.fsum(interactions) + supplied - unsure
        h_pas = lost = 0.0
        if not hold.skipped:  # of several holds the dampers' share of the motion is not known
            for modulated, damper, moved in zip(hold.modulated, hold.damper, hold.displacement, strict=True):
                h_pas += modulated * moved
                lost += damper * moved
        ceiling = motion.energy
        h_r, deficit, leak, paid = self._account.book(h_i, h_pas, lost + motion.internal, ceiling, self._coming)
        command, rendered, certificate = self._render(ceiling, self._coming)
        branch = self._branch(h_i, leak, deficit)
        self._was_engaged = motion.engaged
        account = EnergyBalance(
            math.hypot(*command.torques), h_i, h_pas, h_i - h_pas, h_r, self._account.h_s, self._account.h_dis, 0.0,
            deficit, leak, paid, branch, rendered, certificate, motion.first_state,
        )  # fmt: skip
        return GroupBalance(command.torques, account, interactions, supplied, unsure, motion.limit)

    def _passed(self, holds: int) -> tuple[Values, ...]:
        """Returns the mover's motion in the holds that ended, and looks as many further ahead.

        It is that of the motors at the pose at which it was first asked for: with another pose of the same hold less
        might be booked than was certified.
        """
        motion, known = self._motion, self._coming
        late = max(0, holds - self._holds)
        known = (*known, *motion.carried(-late, late), *motion.carried(self._holds - holds + late, holds - late))
        self._coming = known[holds:]
        return known[:holds]

    def _end(self, hold: EndedHold, applied: Values, carried: tuple[Values, ...]) -> float:
        if hold.skipped:
            return self._account.ended_gap(hold.displacement, (*hold.skipped, applied), carried)
        self._account.ended_hold(hold.displacement, applied)
        return 0.0

    def _branch(self, h_i: float, leak: float, deficit: float) -> int:
        if deficit > 0.0:
            return Branch.DEPLETED.value
        if self._motion.engaged:
            return Branch.EXACT.value if self._was_engaged else Branch.START.value
        return Branch.EXIT.value if self._was_engaged or h_i or leak else Branch.FREE.value

    def _render(self, ceiling: float, coming: tuple[Values, ...]) -> tuple[GroupCommand, float, int]:
        """Sends the torques for the next free hold; returns (command, damping rendered, certificate).

        Args:
            ceiling: What the network stores [J].
            coming: How a mover moves in the holds to come (`GroupMotion.carried`).
        """
        motion, account, nothing = self._motion, self._account, self._commands.nothing
        if not motion.engaged:
            self._commands.send(nothing)
            account.fade(_FADE)
            return nothing, 0.0, Certificate.EXACT.value
        wish = motion.efforts(self._lead)
        energy = account.certain()
        share, lead_share, damper_share, covered = self._shares(wish, energy, ceiling)
        damper = [damper_share * d for d in wish.damper]
        modulated, rendered = self._modulated(wish, damper)
        torques = [
            -(share * s + lead_share * a + d + m)
            for s, a, d, m in zip(wish.spring, wish.lead, damper, modulated, strict=True)
        ]
        wished = GroupCommand(tuple(torques), tuple(damper), tuple(modulated))
        sent, factor, certificate = self._certified(torques, energy, covered, coming)
        if self._splits and factor < 1.0:
            command = self._split(wished, factor, energy)
            self._commands.send(command)
            return command, factor * rendered, certificate
        command = GroupCommand(
            sent,
            tuple([factor * d for d in damper]),
            tuple([factor * m for m in modulated]),
        )
        self._commands.send(command)
        return command, factor * rendered, certificate

    def _split(self, wished: GroupCommand, factor: float, energy: float) -> GroupCommand:
        """Returns a command of which axes that take energy in have more than the certified share of all.

        What the drives leave of it by their grid is a part of what was certified, axis by axis.
        """
        most = self._within_limits(wished.torques)
        torques = tuple([most * t for t in wished.torques])
        found = self._account.raised(torques, factor / most, energy)
        found = tuple([int(t / q) * q if q else t for t, q in zip(found, self._quanta, strict=True)])
        return as_applied(wished, found)

    def _within_limits(self, torques: Sequence[float]) -> float:
        """Returns the largest share of torques, up to 1, that no limit cuts."""
        return min([1.0] + [limit / abs(t) for t, limit in zip(torques, self._limits, strict=True) if abs(t) > limit])

    def _certified(
        self, torques: list[float], energy: float, covered: bool, coming: tuple[Values, ...]
    ) -> tuple[Values, float, int]:
        """Returns the torques to send, their share of those asked for, and the certificate."""
        if not any(torques):
            return tuple(torques), 1.0, Certificate.EXACT.value
        by_force, by_damping, by_speed = self._account.shares(torques, energy, coming)
        factor = self._within_limits(torques)
        largest = max(by_force, by_damping, by_speed)
        if factor > largest:
            factor, covered = largest, False
        certificate = Certificate.EXACT
        if not covered or factor < 1.0:
            certificate = Certificate.HAND_SPEED
            if by_damping >= factor > 0.0:  # of no share at all, what `_split` adds is by hand force
                certificate = Certificate.DEVICE_DAMPING
            elif by_force >= factor:
                certificate = Certificate.HAND_FORCE
        if self._quantised:
            return *self._on_grid(torques, energy, factor, coming), certificate.value
        sent = tuple(torques) if factor == 1.0 else tuple([factor * t for t in torques])
        return sent, factor, certificate.value

    def _on_grid(
        self, torques: list[float], energy: float, factor: float, coming: tuple[Values, ...]
    ) -> tuple[Values, float]:
        """Returns torques rounded towards 0 to what the drives apply, and certified as such.

        Rounding one axis alone is safe; of several it turns the force a little, so that the certificate is asked again.
        """
        for _ in range(_GRID_TRIES):
            sent = tuple(
                [int(factor * t / quantum) * quantum if quantum else factor * t
                 for t, quantum in zip(torques, self._quanta, strict=True)]
            )  # fmt: skip
            if self.axes == 1 or not any(sent):
                return sent, factor
            share = max(self._account.shares(sent, energy, coming))
            if share >= 1.0:
                return sent, factor
            factor *= _GRID_BACK * share
        return self._commands.nothing.torques, 0.0

    def _modulated(self, wish: RequestedEfforts, damper: list[float]) -> tuple[list[float], float]:
        """Returns the efforts of the modulated damper of eq. 19, and the damping rendered along the motion."""
        velocity = wish.velocity
        square = sum([v * v for v in velocity])
        rendered = sum([d * v for d, v in zip(damper, velocity, strict=True)]) / square if square else 0.0
        if not (self._alpha and self._account.h_dis > 0.0 and square):
            return [0.0] * self.axes, rendered
        extra = modulated_damping(
            self._alpha, self._account.h_dis, rendered, min(self._caps), math.sqrt(square) * self._sample_time,
            self._sample_time,
        )  # fmt: skip
        return [extra * v for v in velocity], rendered + extra

    def _shares(self, wish: RequestedEfforts, energy: float, ceiling: float) -> tuple[float, float, float, bool]:
        """Returns the shares of spring, lead and damper to render, and whether the account covers all of them."""
        spring, velocity = wish.spring, wish.velocity
        size, lead_size, damper_size = self._norm(spring), self._norm(wish.lead), self._norm(wish.damper)
        speed = math.sqrt(sum([cap * v * v for cap, v in zip(self._caps, velocity, strict=True)]))
        if wish.internal_speed:
            speed += math.sqrt(max(self._caps)) * wish.internal_speed
        room, share, lead_share, damper_share = speed, 1.0, 1.0, 1.0
        permitted = self._permitted(wish, size, energy, ceiling)
        covered = permitted >= 1.0
        if not covered:
            share = math.sqrt(permitted) if permitted > 0.0 else 0.0
            inward = sum([s * v for s, v in zip(spring, velocity, strict=True)])
            if inward > 0.0:
                catch_up = min(size - share * size, inward / size, room)
                share += catch_up / size
                room -= catch_up
            opposed = sum([a * s / cap for a, s, cap in zip(wish.lead, spring, self._caps, strict=True)]) < 0.0
            if opposed and lead_size > share * size + damper_size:
                lead_share = (share * size + damper_size) / lead_size
        if damper_size > room:
            damper_share, covered = room / damper_size, False
        room += (_LEAD_ROOM - 1.0) * speed - damper_share * damper_size
        if lead_share * lead_size > room:
            lead_share = room / lead_size
        return share, lead_share, damper_share, covered

    def _permitted(self, wish: RequestedEfforts, size: float, energy: float, ceiling: float) -> float:
        """Returns the square of the share of the springs that the account covers; may be above 1."""
        if size == 0.0:
            return 1.0
        permitted = 2.0 * self._calm * energy / (size * size)
        if self._damped:
            total = needed = 0.0
            for s, a, d, k in zip(wish.spring, wish.lead, wish.damper, self._damped, strict=True):
                total += 0.5 * (s + a + d) ** 2 / k
                needed += 0.5 * s * s / k
            self._account.keep(energy, ceiling + total)
            permitted = max(permitted, (energy + self._account.dissipated) / needed)
        if self._path and energy > 0.0:
            permitted = max(permitted, (energy / (self._path * sum([abs(s) for s in wish.spring]))) ** 2)
        return permitted

    def _norm(self, efforts: Sequence[float]) -> float:
        total = 0.0
        for effort, cap in zip(efforts, self._caps, strict=True):
            total += effort * effort / cap
        return math.sqrt(total)
