"""`unprotected`: the sampled environment without protection, and the step of every algorithm that modifies its efforts.

State and velocity of the model come directly from the position, as in most haptic loops, and sampling creates energy.
Energy created is booked as `gen`, energy lost as `leak`, so that the account is balanced. Other algorithms change the
efforts of this model. Each consists of a parameter model, a state in addition to that of the axis, and one function
`respond`, from which `sampled_kernel` makes the kernel::

    class Limp(SteppedController):
        parameters_type = LimpParameters
        kernel = sampled_kernel(respond, LimpState)
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from math import inf
from typing import Any, Generic, NamedTuple, TypeAlias

from canhaptic.control.balance import AT_REST, Branch, Certificate, EnergyBalance
from canhaptic.control.damping import DamperVelocity
from canhaptic.control.environments import Environment, plain
from canhaptic.control.passivity import LoopProperties, stepped
from canhaptic.control.passivity.stepped import Axis, Hold, HoldAccount, begin, close_hold, open_hold
from canhaptic.kernels import GivenT, Kernel, MakeBuffer, Run, StateT, new
from canhaptic.kernels.records import filled

_FREE, _START, _EXACT, _EXIT = Branch.FREE.value, Branch.START.value, Branch.EXACT.value, Branch.EXIT.value


@dataclass(slots=True)
class SampledModel:
    """True state of an environment, and the state that is rendered with its energy."""

    zone: int = 0  # of contact
    true: float = 0.0  # [m or rad]
    state: float = 0.0  # rendered [m or rad]
    h_s: float = 0.0  # energy stored at `state` [J]


class Asked(NamedTuple):
    """Dissipation of the sampled environment in one hold, and the efforts that it requests for the next."""

    branch: int
    h_r: float  # [J]
    touches: bool  # whether the next command carries a torque
    spring: float  # effort of the storage for the next hold [N or N*m]
    damper: float  # effort of the damper for the next hold [N or N*m]
    damping: float  # of that damper, 0 out of contact [N*s/m or N*m*s/rad]


def follow(environment: Environment, model: SampledModel, position: float, hold: Hold) -> Asked:
    """Update the true state to the end of a hold; return the dissipation in it and the efforts for the next hold.

    Call `settle` afterwards.

    Args:
        environment: The sampled environment.
        model: Model; its true state is updated.
        position: Position at the end of the hold [m or rad].
        hold: The hold that ended, from `open_hold`.
    """
    before, displacement, damper = model.true, hold.displacement, hold.damper
    zone, zone_before = environment.contact(position), model.zone
    model.zone = zone
    if zone == 0:
        h_r = 0.0
        if zone_before:
            h_r = max(0.0, damper * (environment.admissible(before + displacement, before) - before))
        model.true = 0.0
        branch = _EXIT if zone_before or hold.h_i != 0.0 or model.h_s != 0.0 else _FREE
        return new(Asked, (branch, h_r, False, 0.0, 0.0, 0.0))
    entered = zone != zone_before
    state = environment.true_state(position, displacement, 0.0 if entered else before)
    before = environment.admissible(state - displacement if entered else before, state)
    h_r = max(0.0, damper * (state - before))
    if environment.relaxes:
        strained = environment.stored_energy(state)
        state = environment.relaxed(state, hold.elapsed)
        h_r += strained - environment.stored_energy(state)
    model.true = state
    damping = environment.damping_at(state)
    spring, damper = environment.effort(state), damping * hold.velocity
    return new(Asked, (_START if entered else _EXACT, h_r, True, spring, damper, damping))


def settle(environment: Environment, model: SampledModel, share: float, h_m: float, h_r: float) -> tuple[float, float]:
    """Set the rendered state and its energy; return the energy that sampling created or lost, (gen, leak) [J].

    Args:
        environment: The sampled environment.
        model: Model; its rendered state is updated.
        share: Rendered state over true state, 0..1.
        h_m: Energy the model received in this hold [J].
        h_r: Energy dissipated in it [J].
    """
    model.state = state = model.true if share == 1.0 else share * model.true
    before = model.h_s
    model.h_s = h_s = environment.stored_energy(state)
    rest = before + h_m - h_r - h_s
    return max(0.0, -rest), max(0.0, rest)


@dataclass(frozen=True, slots=True)
class SampledSettings(Generic[GivenT]):
    """Constants, during a run, of an algorithm that modifies the efforts of the sampled environment."""

    given: GivenT  # parameters of the algorithm; a kernel reads their numbers alone
    limit: float  # of the damping or force that the algorithm adds; infinite: none
    hold: stepped.HoldSettings


@dataclass(slots=True)
class SampledState:
    """State of axis and sampled environment, kept from SYNC to SYNC; an algorithm adds its own fields."""

    axis: Axis = field(default_factory=Axis)
    model: SampledModel = field(default_factory=SampledModel)


SampledRun: TypeAlias = Run[SampledSettings[GivenT], StateT, stepped.HoldMemory]
"""Settings, state and memory of an algorithm with given parameters and state."""


class Reply(NamedTuple):
    """Efforts of the next command, after an algorithm has modified those of the model."""

    stored: float  # share of the model's state whose energy counts as stored, 0..1
    spring: float  # [N or N*m]
    damper: float  # [N or N*m]
    modulated: float  # effort that the algorithm adds [N or N*m]
    damping: float  # of damper and added effort together [N*s/m or N*m*s/rad]


def sampled_settings(
    environment: Environment, parameters: DamperVelocity, loop: LoopProperties, limit: float = inf
) -> SampledSettings[Any]:
    """Return the constants of an algorithm that modifies the efforts of the sampled environment.

    Raises:
        ParameterError: `velocity` is `windowed`, but the encoder count is not declared.
    """
    return SampledSettings(plain(parameters), limit, stepped.hold_settings(parameters, loop, Certificate.NONE))


def respond(run: SampledRun[Any, Any], hold: Hold, asked: Asked) -> Reply:
    """Render the model unchanged: torque = -effort(x) - d v with x and v directly from the position.

    Other algorithms replace this function by their own, which changes the model's efforts for the next hold.
    """
    return new(Reply, (1.0, asked.spring, asked.damper, 0.0, asked.damping))


def step(
    environment: Environment, run: SampledRun[Any, SampledState], position: float, torque_applied: float
) -> EnergyBalance:
    """Book the hold that ended, and compute the next torque; see `Controller.step`."""
    state, memory, settings = run.state, run.memory.axis, run.settings.hold
    axis, model = state.axis, state.model
    if not axis.started:
        begin(axis, memory, position)
        model.zone = environment.contact(position)  # a state displaced there stores energy that never came in
        model.true = environment.true_state(position, 0.0, 0.0) if model.zone else 0.0
        return AT_REST
    hold = open_hold(settings, axis, memory, position, torque_applied)
    asked = follow(environment, model, position, hold)
    stored, spring, damper, modulated, damping = respond(run, hold, asked)
    gen, leak = settle(environment, model, stored, hold.h_i - hold.h_pas, asked.h_r)
    account = new(HoldAccount, (asked.branch, asked.h_r, gen, 0.0, leak))
    efforts = spring, damper, modulated
    return close_hold(run, hold, account, efforts, damping, model.state, model.h_s)


def sampled_kernel(
    respond_as: Callable[[Any, Hold, Asked], Reply],
    state: Callable[[], SampledState] = SampledState,
    settings: Callable[..., SampledSettings[Any]] = sampled_settings,
    kept: Callable[[SampledSettings[Any]], int] = lambda _settings: 0,
) -> Kernel:
    """Return the kernel of an algorithm that modifies the efforts of the sampled environment.

    Args:
        respond_as: Function of the algorithm that replaces `respond`.
        state: Factory of the state at rest.
        settings: (environment, parameters, loop) -> constants of a run.
        kept: Constants of the run -> length of the algorithm's own buffer.
    """

    def memory_of(made: SampledSettings[Any], make_buffer: MakeBuffer) -> stepped.HoldMemory:
        return stepped.hold_memory(made, make_buffer, kept(made))

    return Kernel(settings, state, memory_of, filled(step, respond=respond_as))


class Unprotected(stepped.SteppedController):
    """Controller that renders the sampled environment without protection: torque = -effort(x) - d v."""

    parameters_type = DamperVelocity
    kernel = sampled_kernel(respond)
