"""`step_scaling`: the network's step is scaled until its energy balances the hold. The paper's way, on several axes.

    H(x + l s) - H(x) + l L = H_m,    s the step of the model, L what its dissipators take with l = 1

L holds the damper efforts that were inside the torques applied in that very hold, times the displacement, and what is
dissipated inside the network. Of one axis with spring and damper it is `passivity.internal_dissipation` to rounding,
start by eq. 14, exact and sticky root, eq. 18 where there is none, exit. The state creeps away from that of the model,
and no torque is limited: `guarded` is more accurate, and certified.
"""

import math
from collections.abc import Sequence
from typing import ClassVar

from canhaptic.control.balance import AT_REST, Branch, Certificate, EnergyBalance
from canhaptic.control.mechanisms.kinematics import Kinematics
from canhaptic.control.multi_axis.group_commands import EndedHold, GroupCommand, GroupCommands, Values
from canhaptic.control.multi_axis.group_controller import GroupBalance, NetworkEnvironment, group_at_rest
from canhaptic.control.multi_axis.requested_efforts import GroupMotion
from canhaptic.control.multi_axis.scaled_state import ScaledState
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.control.passivity.hold_account import HoldAccount
from canhaptic.control.recovery import Alpha, damping_cap, modulated_damping
from canhaptic.errors import ControlError
from canhaptic.units import Parameters

_NO_CAP = 1e12


class ScaledGroupParameters(Parameters):
    """What is left to choose."""

    alpha: Alpha = 0.0
    """Modulated damping per joule of surplus (eq. 19), always with its unit; 0 leaves the surplus standing."""
    compiled: bool = False
    """Whether the network's equation runs compiled by numba (the extra `fast`); pays with masses, some seconds once."""


class ScaledGroup:
    """A network whose state is the one that was paid for; see `GroupController`."""

    parameters_type: ClassVar[type[Parameters]] = ScaledGroupParameters

    def __init__(
        self,
        environment: NetworkEnvironment,
        kinematics: Kinematics,
        parameters: ScaledGroupParameters,
        loops: tuple[LoopProperties, ...],
    ) -> None:
        self._motion = motion = GroupMotion(environment, kinematics, loops, parameters.compiled)
        self._state = ScaledState(motion, loops[0].delay)
        self.axes = axes = kinematics.axes
        self._sample_time, self._alpha = loops[0].sample_time, parameters.alpha
        self._caps = [min(_NO_CAP, damping_cap(loops[0].delay, lo.moving_mass, self._sample_time)) for lo in loops]
        self._commands = GroupCommands(axes, loops[0].delay, [loop.torque_limit for loop in loops], motion.ports)
        self.reset()

    def reset(self) -> None:
        """Forgets everything; see `GroupController`."""
        self._commands.reset()
        self._motion.reset()
        self._state.reset()
        self._h_dis = 0.0
        self._previous: Values = (0.0,) * self.axes

    def hold(self) -> GroupBalance:
        """Repeats the last commands for want of a sample; see `GroupController`."""
        torques = self._commands.lose_hold()
        self._motion.skip()
        balance = AT_REST._replace(
            torque=math.hypot(*torques), h_s=self._state.h_s, h_dis=self._h_dis, branch=Branch.HELD.value,
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
            motion.begin(positions)
            self._state.begin()
            self._h_dis = 0.0
            return group_at_rest(self.axes)
        holds = 1 + len(hold.skipped)
        unsure = self._unsure(hold, applied)
        interactions = tuple([-t * d for t, d in zip(applied, hold.displacement, strict=True)])
        motion.move(positions, hold.displacement, holds)
        supplied = motion.supplied(hold.ports)
        h_i = math.fsum(interactions) + supplied - unsure
        h_pas = sum([m * d for m, d in zip(hold.modulated, hold.displacement, strict=True)])
        damped = sum([f * d for f, d in zip(hold.damper, hold.displacement, strict=True)])
        account = self._state.exchange(h_i - h_pas, damped, hold.power * holds)
        surplus = self._h_dis + account.gen + account.deficit - h_pas
        paid = min(account.leak, surplus) if account.leak > 0.0 and surplus > 0.0 else 0.0
        self._h_dis = surplus - paid
        command, rendered = self._command(hold.displacement, holds)
        self._commands.send(command)
        balance = self._balance(command, h_i, h_pas, account, paid, rendered)
        return GroupBalance(command.torques, balance, interactions, supplied, unsure, motion.limit)

    def _balance(
        self, command: GroupCommand, h_i: float, h_pas: float, account: HoldAccount, paid: float, rendered: float
    ) -> EnergyBalance:
        return EnergyBalance(
            math.hypot(*command.torques), h_i, h_pas, h_i - h_pas, account.h_r, self._state.h_s, self._h_dis,
            account.gen, account.deficit, account.leak, paid, account.branch, rendered, Certificate.NONE.value,
            self._motion.first_state,
        )  # fmt: skip

    def _unsure(self, hold: EndedHold, applied: Values) -> float:
        """Returns the worst error of the energy over holds of which only the whole displacement is known [J]."""
        total = 0.0
        for i, (moved, before, torque) in enumerate(zip(hold.displacement, self._previous, applied, strict=True)):
            if hold.skipped:
                excursion = abs(moved) + len(hold.skipped) * abs(before)
                total += sum([abs(sent[i] - torque) for sent in hold.skipped]) * excursion
        self._previous = hold.displacement
        return total

    def _command(self, displacement: Values, holds: int) -> tuple[GroupCommand, float]:
        """Returns the torques of the state, its dampers and the modulated damper, and the damping rendered."""
        motion = self._motion
        if not self._state.engaged:
            return self._commands.nothing, 0.0
        springs, dampers, ports, power = self._state.efforts(holds)
        elapsed = motion.elapsed
        velocity = [self._state.pace * d / elapsed for d in displacement]
        size = sum([d * d / cap for d, cap in zip(dampers, self._caps, strict=True)])
        room = sum([cap * v * v for v, cap in zip(velocity, self._caps, strict=True)])
        if size > room and not motion.network.tables.moving:
            share = math.sqrt(room / size)
            dampers, power = [share * d for d in dampers], share * power
        square = sum([v * v for v in velocity])
        rendered = sum([d * v for d, v in zip(dampers, velocity, strict=True)]) / square if square else 0.0
        modulated = [0.0] * self.axes
        moved = math.hypot(*displacement)
        if self._alpha and self._h_dis > 0.0 and moved:
            extra = modulated_damping(self._alpha, self._h_dis, rendered, min(self._caps), moved, elapsed)
            modulated, rendered = [extra * d / elapsed for d in displacement], rendered + extra
        torques = tuple([-s - d - m for s, d, m in zip(springs, dampers, modulated, strict=True)])
        return GroupCommand(torques, tuple(dampers), tuple(modulated), tuple(ports), power), rendered
