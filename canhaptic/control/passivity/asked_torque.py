"""Limiter of the torques that a user's program requests, with an energy tank and the certificates of `guarded`.

The energy that a program stores is unknown, so nothing is rendered, predicted or dissipated here. The tank is the
account: it holds the energy received and not yet returned to the user, up to `earned_energy` if that is set. From this
energy the certificates (proofs from declared properties of hand and device, see `guarded`) give a bound for each
torque. A larger requested torque is reduced to the bound, any other is sent unchanged. Device dissipation beyond the
need of the requested torque is discarded, as in `guarded`.

A program without this limiter has an account but no certificate.
"""

from dataclasses import dataclass
from math import copysign, inf
from typing import TypeAlias

from canhaptic.control.balance import Branch, Certificate, EnergyBalance
from canhaptic.control.certificates.certified_torque import keep, look_for_turn
from canhaptic.control.damping import VelocityWindow, restart, update
from canhaptic.control.environments import StoresNothing
from canhaptic.control.environments.free_space import FreeSpace
from canhaptic.control.passivity import LoopProperties, guarded
from canhaptic.control.passivity.guarded import book, certain_energy, end, permitted_size, start
from canhaptic.control.passivity.stepped import SteppedController, send, towards_zero
from canhaptic.control.passivity.unprotected import Unprotected
from canhaptic.kernels import Kernel, Run, list_of_zeros, new
from canhaptic.units import Parameters

_FREE, _EXACT = Branch.FREE.value, Branch.EXACT.value
_EXIT, _DEPLETED = Branch.EXIT.value, Branch.DEPLETED.value
_NOT_BOUND = Certificate.EXACT.value
_LONGEST_WINDOW = 0.02
"""Longest window of the velocity estimate that a program can read [s]."""


class Program(FreeSpace):
    """A user's program that computes torques, in place of an environment; how it computes them is unknown."""


class AskedEffort(StoresNothing):
    """The program in the form of an environment: the requested torque at every position, and no stored energy.

    Attributes:
        asked: Requested torque [N or N*m].
    """

    damping, linear_stiffness = 0.0, None

    def __init__(self) -> None:
        self.asked = 0.0

    def true_state(self, position: float, displacement: float, previous: float) -> float:
        """Return 0 [m or rad]: a program has no storage with a displacement."""
        return 0.0

    def effort(self, state: float) -> float:
        """Return the effort of the requested torque [N or N*m]."""
        return -self.asked


@dataclass(slots=True)
class AskedState(guarded.GuardedState):
    """State of one axis, with the size of its energy tank, kept from SYNC to SYNC."""

    size: float = inf  # of the tank beyond `GuardedSettings.earned` [J]


AskedRun: TypeAlias = Run[guarded.GuardedSettings, AskedState, guarded.Memory]
"""Settings, state and memory of one axis."""


def step(environment: AskedEffort, run: AskedRun, position: float, torque_applied: float) -> EnergyBalance:
    """Book the hold that ended, and compute the next torque; see `Controller.step`."""
    settings, state, memory = run.settings, run.state, run.memory
    axis = state.axis
    if not axis.started:
        return start(run, position)
    holds, torque, open_before = axis.missed + axis.hold_length, environment.asked, state.bound.resolution
    displacement, _, _, uncertainty = end(run, position, torque_applied)
    reserved = 0.5 * (state.bound.resolution - open_before)
    if settings.turns:  # the program may ask for a torque either way
        look_for_turn(settings.declared, state.bound, memory.bound, displacement, holds)
    h_i = -torque_applied * displacement - uncertainty  # eq. 2
    h_r, deficit, leak, paid = book(run, h_i, 0.0, 0.0, state.size)
    branch, certificate = _EXACT, _NOT_BOUND
    if torque != 0.0:
        torque, certificate = granted(run, torque, displacement / holds)
    else:
        branch = _EXIT if h_i != 0.0 or leak != 0.0 else _FREE
    axis.oldest = send(memory.axis.commands, axis.oldest, torque, 0.0, 0.0)
    if reserved:
        h_i, h_r = h_i + reserved, h_r + reserved
    return new(EnergyBalance, (
        torque, h_i, 0.0, h_i, h_r, state.h_s, axis.h_dis, 0.0, deficit, leak, paid,
        _DEPLETED if deficit > 0.0 else branch, 0.0, certificate, 0.0, 0.0,
    ))  # fmt: skip


def granted(run: guarded.GuardedRun, asked: float, moved: float) -> tuple[float, int]:
    """Return a requested torque, reduced to what the certificates permit [N or N*m], and the certificate's number.

    Args:
        run: Run of the axis.
        asked: Requested torque, not 0 [N or N*m].
        moved: Mean displacement per hold since the last position [m or rad].
    """
    settings, state = run.settings, run.state
    bound, energy = state.bound, state.h_s - state.axis.h_dis + settings.allowance
    if bound.dissipated > 0.0:
        enough = settings.earned
        if settings.damped_stiffness > 0.0:
            most = min(abs(asked), settings.torque_limit)
            enough = max(enough, 0.5 * most * most / settings.damped_stiffness)
        keep(bound, energy, max(0.0, energy) + enough)
    if settings.longest_window:
        energy = certain_energy(state, energy)
    size, certificate = permitted_size(run, asked, energy, moved)
    return towards_zero(copysign(size, asked), settings.quantum), certificate


class _Asks(SteppedController):
    """Controller of a user's program, which requests a torque before each step."""

    def __init__(self, parameters: Parameters, loop: LoopProperties) -> None:
        self._effort = AskedEffort()
        self._sample_time, self._count = loop.sample_time, loop.encoder_count or 1e-9
        self._window = VelocityWindow()
        self._positions = list_of_zeros(max(2, round(_LONGEST_WINDOW / loop.sample_time)) + 1)
        super().__init__(self._effort, parameters, loop)

    @property
    def asked(self) -> float:
        """Torque requested last [N or N*m]."""
        return self._effort.asked

    def ask(self, torque: float) -> None:
        """Request a finite torque for the next step [N or N*m]."""
        self._effort.asked = torque

    def velocity(self, position: float, periods: int) -> float:
        """Add a position to the window of the velocity estimate, and return the velocity [m/s or rad/s].

        Args:
            position: Position at this SYNC [m or rad].
            periods: Sample times since the position added before; 0: this is the first.
        """
        window, positions = self._window, self._positions
        if periods == 1:
            update(window, positions, self._count, self._sample_time, position)
        else:
            before = positions[window.newest]
            restart(window, positions, position)
            window.velocity = (position - before) / (periods * self._sample_time) if periods else 0.0
        return window.velocity


def settings_of_program(
    environment: AskedEffort, parameters: guarded.GuardedParameters, loop: LoopProperties
) -> guarded.GuardedSettings:  # fmt: skip
    """Return the settings of `guarded` for a program, whose torque may reverse at any SYNC.

    The hand is therefore assumed to apply the larger of `hand_force` and `hand_push` in both directions.

    Args:
        environment: The program.
        parameters: Declared properties of hand and device.
        loop: Constants of the loop.
    """
    force, push = parameters.hand_force, parameters.hand_push
    if force is not None and push is not None and push > force:
        parameters = parameters.model_copy(update={"hand_force": push})
    return guarded.settings_of(environment, parameters, loop)


class GuardedProgram(_Asks, guarded.Guarded):
    """Controller that sends a program's torques, reduced to what the certificates permit."""

    parameters_type = guarded.GuardedParameters
    kernel = Kernel(settings_of_program, AskedState, guarded.memory_of, step)

    def __init__(self, parameters: guarded.GuardedParameters, loop: LoopProperties) -> None:
        self._size = inf if parameters.earned_energy is None else 0.0
        super().__init__(parameters, loop)

    def reset(self) -> None:
        """Clear the state; see `Controller.reset`."""
        super().reset()
        self._state.size = self._size


class UnguardedProgram(_Asks):
    """Controller that sends a program's torques without any certificate."""

    parameters_type = Unprotected.parameters_type
    kernel = Unprotected.kernel
