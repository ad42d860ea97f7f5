"""An algorithm of a group in the cycle: keeps the state of the kernel, and refuses values that are not finite."""

from collections.abc import Callable, Sequence
from functools import partial
from math import isfinite
from typing import Any, ClassVar

from canhaptic.control.balance import AT_REST, Branch
from canhaptic.control.mechanisms.kinematics import Kinematics
from canhaptic.control.multi_axis.group_commands import norm, send_nothing
from canhaptic.control.multi_axis.group_controller import GroupBalance, NetworkEnvironment, group_at_rest
from canhaptic.control.multi_axis.group_kernel import GroupKernel, GroupRun
from canhaptic.control.multi_axis.group_motion import World, world_of
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.errors import ControlError
from canhaptic.kernels import with_quick_fields
from canhaptic.units import Parameters

_HELD = Branch.HELD.value


def interpreted_run(kernel: GroupKernel, world: World, settings: Any) -> Callable[[], GroupRun]:
    """Return the function that begins an interpreted run."""
    fixed = with_quick_fields(world), with_quick_fields(settings)

    def begin() -> GroupRun:
        memory = with_quick_fields(kernel.memory(world, settings))
        step = partial(kernel.step, *fixed, kernel.state(), memory)
        commands = memory.group.commands
        return GroupRun(step, commands.torques, memory.group.ended.interactions, partial(send_nothing, commands))

    return begin


class SteppedGroup:
    """A kernel with the state of one group; see `GroupController`.

    Attributes:
        energy_resolution: Largest excess of the energy that came in, due to late torques and lost samples [J].
    """

    parameters_type: ClassVar[type[Parameters]]
    kernel: ClassVar[GroupKernel]

    def __init__(
        self,
        environment: NetworkEnvironment,
        kinematics: Kinematics,
        parameters: Any,
        loops: tuple[LoopProperties, ...],
    ) -> None:
        """Prepare a run; `parameters` is of `parameters_type`.

        Raises:
            ParameterError: Parts do not fit together, or the algorithm cannot do without something that is not known.
        """
        self.axes = kinematics.axes
        world = world_of(environment, kinematics, loops)
        settings = self.kernel.settings(world, parameters, loops)
        self._begin: Callable[[], GroupRun] = interpreted_run(self.kernel, world, settings)
        self.reset()

    def reset(self) -> None:
        """Forget everything; see `GroupController`."""
        self._step, self._torques, self._interactions, self._withhold = self._begin()
        self._missed = self._newest = 0
        self.energy_resolution = 0.0
        self._last = group_at_rest(self.axes)
        self._started = False

    def lasted(self, periods: float) -> None:
        """Count skipped SYNCs as lost samples: only the total displacement of all holds is known.

        Args:
            periods: Length of the hold that the next `step` ends [sample times].
        """
        self._missed += (round(periods) - 1) * self._started

    def hold(self) -> GroupBalance:
        """Repeat the last commands at a SYNC without a sample; see `GroupController`."""
        self._missed += self._started
        torques, last = self._last.torques, self._last.account
        account = AT_REST._replace(
            torque=norm(torques), h_s=last.h_s, h_dis=last.h_dis, branch=_HELD, state=last.state
        )  # fmt: skip
        return GroupBalance(torques, account, (0.0,) * self.axes)

    def withhold(self) -> None:
        """Record that the torques of the last `step` are not sent: in a dry run the drives hold none."""
        self._withhold(self._newest)

    def step(self, positions: Sequence[float], torques_applied: Sequence[float]) -> GroupBalance:
        """Book the hold that ended; see `GroupController`."""
        total = 0.0
        for value in (*positions, *torques_applied):
            total += value - value  # 0, or NaN where it is not finite
        if total != 0.0 or not len(positions) == len(torques_applied) == self.axes:
            self.reset()
            raise ControlError(
                f"group controller: got positions {tuple(positions)} and applied torques {tuple(torques_applied)}, "
                f"expected {self.axes} finite numbers each; torque is zero and the controller was reset; check "
                "the encoders"
            )
        account, supplied, unsure, further, limit, place = self._step(self._missed, positions, torques_applied)
        torques = tuple(self._torques[place])
        if not isfinite(sum(torques)):
            self.reset()
            raise ControlError(
                f"group controller: computed torques {torques}, expected finite numbers; torque is zero and "
                "the controller was reset; check stiffness and damping against the size of the motion"
            )
        self.energy_resolution += further
        self._started, self._missed, self._newest = True, 0, place
        self._last = GroupBalance(torques, account, tuple(self._interactions), supplied, unsure, limit)
        return self._last
