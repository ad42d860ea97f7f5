from math import isfinite
from typing import ClassVar, NamedTuple

from canhaptic.control.balance import AT_REST, Branch, EnergyBalance
from canhaptic.errors import ControlError
from canhaptic.kernels import list_of_zeros, with_quick_fields
from canhaptic.units import Parameters
from tests.control.old_forms.kernel import Kernel

_HELD = Branch.HELD.value


class Wording(NamedTuple):
    effort: str
    command: str
    sensors: str
    values: str


class SteppedController:
    parameters_type: ClassVar[type[Parameters]]
    kernel: ClassVar[Kernel]
    wording: ClassVar[Wording] = Wording(
        "applied torque",
        "torque",
        "the encoder and its scaling",
        "stiffness and damping against the size of the motion",
    )

    def __init__(self, environment: object, parameters: Parameters, loop: Parameters) -> None:
        self._environment = environment
        self._settings = self.kernel.settings(environment, parameters, loop)
        self._step = self.kernel.step
        self.reset()

    def reset(self) -> None:
        self._state = self.kernel.state()
        self._axis = self._state.axis
        self._memory = with_quick_fields(self.kernel.memory(self._settings, list_of_zeros))
        self._last = AT_REST

    def hold(self) -> EnergyBalance:
        command = self._command_unseen() if self._axis.started else self._last.torque
        return self._last._replace(
            torque=command, branch=_HELD, h_i=0.0, h_pas=0.0, h_m=0.0, h_r=0.0, gen=0.0, deficit=0.0, leak=0.0, paid=0.0
        )

    def _command_unseen(self) -> float:
        self._axis.missed += 1
        return self._last.torque

    def lasted(self, periods: float) -> None:
        self._axis.lasted += periods - 1.0

    def step(self, position: float, torque_applied: float) -> EnergyBalance:
        if not isfinite(position - self._axis.position + torque_applied):
            effort, command, sensors, _ = self.wording
            self.reset()
            raise ControlError(
                f"controller: got position {position!r} and {effort} {torque_applied!r}, expected finite numbers; "
                f"{command} is zero and the controller was reset; check {sensors}"
            )
        balance: EnergyBalance = self._step(
            self._environment, self._settings, self._state, self._memory, position, torque_applied
        )
        if not isfinite(balance[0]):
            _, command, _, values = self.wording
            self.reset()
            raise ControlError(
                f"controller: computed {command} {balance.torque!r}, expected a finite number; "
                f"{command} is zero and the controller was reset; check {values}"
            )
        self._last = balance
        return balance
