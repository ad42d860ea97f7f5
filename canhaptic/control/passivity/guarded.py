"""`guarded`: the paper's energy balance with a certified bound on the torque of every hold. The default for rigs.

What is rendered is the environment at its true state, predicted to the hold in which the torque acts (`prediction`). A
torque held at the middle value lets a spring take in, and give back, what a continuous one would; a torque held at the
starting value gives k D^2 / 2 too much in every hold, which is where the energy of a sampled wall comes from. Aimed a
quarter of a hold further, a spring without a damper calms down. The damper has the predicted velocity too.

The account is (8) with the damper between port and ground: h_r = f_d D with f_d the damper effort inside the torque
that was applied, never negative, never more than what the torques under way leave. Nothing is created at the start of
contact: the store begins empty and pushing on fills it. What the account does not cover is not rendered:

* the spring effort stays below that of a spring with the energy in the account, as stiff as the certificate holds;
* beyond it, only while moving inward, a damper brings in the missing energy, all of it stored; and a spring whose
  account is short is led as if no torque slowed the axis down;
* and the torque stays below what the declared certificates hold together (`sum_of_certificates`): that is the proof.

What came in beyond the store (a drag in free motion, a wall left behind) or was dissipated by the device for certain is
kept for contacts to come as far as `earned_energy`. From no energy at all no torque begins below an inward speed of
(1 + delay) F_h T / m: a hand of F_h could turn every slower motion outward before the torque ends, so that energy would
come out first. Only certain dissipation of the device allows a slower start.

For every user without exception, sum(h_i) >= 0 admits no torque at all: a larger promise relies on something known
of the hand or of the device. A hand force of 0 is the usual setting: it covers every hand that does not pull the axis
along the torque, and is not the same as "never active". Where stiffness or damping cannot be rendered the environment
gets softer, and the balance says so: `certificate` is not EXACT, `damping_rendered` is below the one asked.
"""

from typing import ClassVar

from canhaptic.control.balance import AT_REST, Branch, Certificate, EnergyBalance
from canhaptic.control.certificates.torque_bound import turn
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.control.passivity.guarded_account import GuardedState, Memory, book, end, memory_of, relax
from canhaptic.control.passivity.guarded_settings import GuardedParameters, GuardedSettings, settings_of
from canhaptic.control.passivity.guarded_torque import drag, render
from canhaptic.control.passivity.hold_account import Axis, begin
from canhaptic.control.passivity.in_flight import send
from canhaptic.control.passivity.stepped import SteppedController
from canhaptic.kernels import Kernel, Run, new
from canhaptic.units import Parameters

_FREE, _START, _EXACT = Branch.FREE.value, Branch.START.value, Branch.EXACT.value
_STICKY, _DEPLETED = Branch.STICKY.value, Branch.DEPLETED.value
_EXIT, _UNBOUNDED = Branch.EXIT.value, Certificate.EXACT.value


def step(
    environment: Environment, run: Run[GuardedSettings, GuardedState, Memory], position: float, torque_applied: float
) -> EnergyBalance:
    """Account for the hold that ended; see `Controller.step`."""
    settings, state, memory = run.settings, run.state, run.memory
    zone, zone_before, axis = environment.contact(position), state.zone, state.axis
    state.zone = zone
    if not axis.started:
        return start(environment, settings, state, memory, position)
    holds, same = axis.missed + axis.lasted, zone == zone_before
    displacement, damper, modulated, unsure = end(settings, state, memory, position, torque_applied)
    true = environment.true_state(position, displacement, state.true if same else 0.0) if zone else 0.0
    if not same and zone:
        turn(settings.declared, state.bound, way_out(environment, true))
    ceiling = environment.stored_energy(true) if zone else 0.0
    h_i, h_pas = -torque_applied * displacement - unsure, modulated * displacement  # `interaction_energy`
    h_r, deficit, leak, paid = book(settings, state, memory, h_i, h_pas, damper * displacement, ceiling)
    if zone:
        if environment.relaxes:
            true, ceiling, lost = relax(environment, settings, state, true, ceiling, holds)
            h_r += lost
        spring, moved = environment.effort(true), displacement / holds
        travel, inside = (true - state.true) / holds, moved
        if settings.longest_window or not same:
            travel, inside = motion_inside(environment, settings, axis, travel, displacement, holds, true, same)
        torque, damper, modulated, rendered, certificate = render(
            environment, settings, state, memory, true, spring, ceiling, travel, inside, moved, same
        )
        branch = _START if not same else _STICKY if h_i > 0.0 and displacement * spring < 0.0 else _EXACT
    else:
        torque, damper, modulated, rendered, certificate = 0.0, 0.0, 0.0, 0.0, _UNBOUNDED
        branch = _EXIT if zone_before or ((h_i != 0.0 or leak != 0.0) and settings.drag == 0.0) else _FREE
        if settings.drag or state.bound.dissipated > 0.0:
            torque, certificate = drag(settings, state, memory, displacement / holds)
    axis.oldest = send(memory.axis.commands, axis.oldest, torque, damper, modulated)
    h_s, state.true = state.h_s, true
    stored = true if h_s >= ceiling else environment.state_of_energy(h_s, true)
    return new(EnergyBalance, (
        torque, h_i, h_pas, h_i - h_pas, h_r, h_s, axis.h_dis, 0.0, deficit, leak, paid,
        _DEPLETED if deficit > 0.0 else branch, rendered, certificate, stored,
    ))  # fmt: skip


def start(
    environment: Environment, settings: GuardedSettings, state: GuardedState, memory: Memory, position: float
) -> EnergyBalance:
    """Take the first position [m or rad]; return the balance of a step that books nothing."""
    begin(state.axis, memory.axis, position)
    state.bound.out = settings.outside if settings.drag > 0.0 else 0.0
    if state.zone:
        turn(settings.declared, state.bound, way_out(environment, environment.true_state(position, 0.0, 0.0)))
    return AT_REST


def way_out(environment: Environment, true: float) -> float:
    """Return the direction out of a contact, 1 or -1; 0 where its storage works both ways and it has none."""
    if environment.admissible(-true, true) == -true:
        return 0.0
    return 1.0 if true < 0.0 else -1.0


def motion_inside(
    environment: Environment, settings: GuardedSettings, axis: Axis, travel: float, displacement: float, holds: float,
    true: float, same: bool,
) -> tuple[float, float]:  # fmt: skip
    """Return the motion of storage and damper in a hold [m or rad], the smooth one where an encoder is coarse.

    Args:
        environment: Environment rendered.
        settings: Constants of the run.
        axis: The axis, after its motion.
        travel: Motion of the storage in a hold, where the contact was there before [m or rad].
        displacement: Displacement since the last position [m or rad].
        holds: Number of holds since then.
        true: State of the storage [m or rad].
        same: Whether the contact was there before.
    """
    inside = displacement / holds
    if not same:
        travel = inside
    if settings.longest_window and not environment.relaxes:
        travel = inside = axis.window.velocity * settings.sample_time
    if not same:
        inside = (true - environment.admissible(true - displacement, true)) / holds
    return travel, inside


class Guarded(SteppedController):
    """An environment rendered as far as the certificates allow."""

    parameters_type: ClassVar[type[Parameters]] = GuardedParameters
    kernel: ClassVar[Kernel] = Kernel(settings_of, GuardedState, memory_of, step)

    def __init__(self, environment: Environment, parameters: GuardedParameters, loop: LoopProperties) -> None:
        super().__init__(environment, parameters, loop)
        self.max_consecutive_losses = parameters.max_consecutive_losses
        self.energy_allowance = parameters.energy_allowance

    @property
    def energy_resolution(self) -> float:
        """Uncertainty of the sum of h_i where torques came late or samples were lost [J].

        Its lower end is booked.
        """
        resolution: float = self._state.bound.resolution
        return resolution

    def hold(self) -> EnergyBalance:
        """Repeat the last command at a SYNC without a position; see `Controller.hold`.

        The next `step` books the displacement over all holds with the torque read back, less the uncertainty.
        """
        return super().hold()._replace(damping_rendered=0.0, certificate=_UNBOUNDED)
