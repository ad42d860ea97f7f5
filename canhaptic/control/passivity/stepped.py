"""A passivity algorithm in the cycle: keeps the state of the kernel, and refuses values that are not finite."""

from math import isfinite
from typing import ClassVar, NamedTuple

from canhaptic.control.balance import AT_REST, Branch, EnergyBalance
from canhaptic.control.passivity.in_flight import send
from canhaptic.errors import ControlError, ParameterError
from canhaptic.kernels import Kernel, Run, list_of_zeros, with_quick_fields
from canhaptic.units import Parameters

_HELD = Branch.HELD.value
_TAKEN = 4
"""Arguments of the step of a kernel: environment, run, position, torque applied."""


class Wording(NamedTuple):
    """Names of input and output of a controller, for its messages."""

    effort: str  # in addition to the position
    command: str
    sensors: str  # advice where an input is not finite
    values: str  # advice where an output is not finite


class SteppedController:
    """A kernel with the state of one axis; see `Controller`."""

    parameters_type: ClassVar[type[Parameters]]
    kernel: ClassVar[Kernel]
    wording: ClassVar[Wording] = Wording(
        "applied torque",
        "torque",
        "the encoder and its scaling",
        "stiffness and damping against the size of the motion",
    )

    def __init_subclass__(cls) -> None:
        """Refuse a kernel whose step takes settings, state and memory one by one, as kernels once did.

        Raises:
            ParameterError: It does.
        """
        kernel = vars(cls).get("kernel")
        if kernel is not None and kernel.step.__code__.co_argcount != _TAKEN:
            raise ParameterError(
                f"{cls.__name__}: got a step of {kernel.step.__code__.co_argcount} arguments, expected (environment, "
                "run, position, torque_applied): settings, state and memory are fields of run; see docs/extending.md"
            )

    def __init__(self, environment: object, parameters: Parameters, loop: Parameters) -> None:
        """Prepare a run; `parameters` is of `parameters_type`.

        Raises:
            ParameterError: A property that the algorithm needs is unknown.
        """
        self._environment = environment
        self._settings = self.kernel.settings(environment, parameters, loop)
        self._step = self.kernel.step
        self.reset()

    def reset(self) -> None:
        """Clear the state: zero stored energy, no torque in flight, no last position."""
        self._state = self.kernel.state()
        self._axis = self._state.axis
        self._memory = with_quick_fields(self.kernel.memory(self._settings, list_of_zeros))
        self._run = with_quick_fields(Run(self._settings, self._state, self._memory))
        self._last = AT_REST

    def hold(self) -> EnergyBalance:
        """Answer a SYNC whose position was lost; nothing is booked. See `Controller.hold`."""
        command = self._command_unseen() if self._axis.started else self._last.torque
        return self._last._replace(
            torque=command, branch=_HELD, h_i=0.0, h_pas=0.0, h_m=0.0, h_r=0.0, gen=0.0, deficit=0.0, leak=0.0, paid=0.0
        )

    def _command_unseen(self) -> float:
        """Return the command of a SYNC without a sample: the last one."""
        self._axis.missed += 1
        return self._last.torque

    def lasted(self, periods: float) -> None:
        """Record that the hold that the next `step` ends lasted this number of sample times, as SYNCs were skipped."""
        self._axis.lasted += periods - 1.0

    def withhold(self) -> None:
        """Record that the command of the last `step` is not sent: in a dry run the drive holds no torque."""
        commands = getattr(getattr(self._memory, "axis", self._memory), "commands", None)
        if commands is not None:  # own code may keep none
            send(commands, self._axis.oldest - 1, 0.0, 0.0, 0.0)

    def step(self, position: float, torque_applied: float) -> EnergyBalance:
        """Account for the hold that ended; see `Controller.step`."""
        if not isfinite(position - self._axis.position + torque_applied):
            effort, command, sensors, _ = self.wording
            self.reset()
            raise ControlError(
                f"controller: got position {position!r} and {effort} {torque_applied!r}, expected finite numbers; "
                f"{command} is zero and the controller was reset; check {sensors}"
            )
        balance: EnergyBalance = self._step(self._environment, self._run, position, torque_applied)
        if not isfinite(balance[0]):
            _, command, _, values = self.wording
            self.reset()
            raise ControlError(
                f"controller: computed {command} {balance.torque!r}, expected a finite number; {command} is zero and "
                f"the controller was reset; check {values}"
            )
        self._last = balance
        return balance
