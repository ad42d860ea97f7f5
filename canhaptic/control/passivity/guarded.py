"""`guarded`: the paper's energy balance with a certified bound on the torque of every hold. The default for rigs.

What is rendered is the environment at its true state, predicted to the middle of the hold in which the torque acts. A
torque held at the middle value lets a spring take in, and give back, what a continuous one would; a torque held at the
starting value gives k D^2 / 2 too much in every hold, which is where the energy of a sampled wall comes from. The lead
acts like a damper of k T (1/2 + delay) that dissipates nothing: it only cancels what the hold creates.

The account is (8) with the damper between port and ground: h_r = f_d D with f_d the damper effort inside the torque
that was applied, never negative, never more than what the torques under way leave. Nothing is created at the start of
contact: the store begins empty and pushing on fills it. What the account does not cover is not rendered:

* the spring effort stays below that of a spring with the energy in the account, as stiff as this rate renders calmly;
* beyond it, only while moving inward, a damper brings in what is missing and all of that is stored;
* and the torque stays below the largest of the declared certificates (`certificates`), which is the proof.

For every user without exception, sum(h_i) >= 0 admits no torque at all: whoever promises more relies on something known
of the hand or of the device. A hand force of 0 is the usual setting: it covers every hand that does not pull the axis
along the torque, and is not the same as "never active". Where stiffness or damping cannot be rendered the environment
gets softer, and the balance says so: `certificate` is not EXACT, `damping_rendered` is below the one asked.
"""

import math
from collections import deque
from typing import Annotated, ClassVar, Final

from canhaptic.control.balance import AT_REST, Branch, Certificate, EnergyBalance, interaction_energy
from canhaptic.control.certificates.scalar_bounds import displacement_response
from canhaptic.control.certificates.torque_bound import Declared, TorqueBound
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.control.passivity.in_flight import CommandsInFlight
from canhaptic.control.passivity.settlement import settle
from canhaptic.control.recovery import Alpha, damping_cap, modulated_damping
from canhaptic.control.velocity import AdaptiveWindow
from canhaptic.errors import ControlError, ParameterError
from canhaptic.units import Parameters, quantity

_FREE, _START, _EXACT = Branch.FREE.value, Branch.START.value, Branch.EXACT.value
_STICKY, _DEPLETED = Branch.STICKY.value, Branch.DEPLETED.value
_EXIT, _HELD = Branch.EXIT.value, Branch.HELD.value
_UNBOUNDED, _BY_FORCE = Certificate.EXACT.value, Certificate.HAND_FORCE.value
_BY_DAMPING, _BY_SPEED = Certificate.DEVICE_DAMPING.value, Certificate.HAND_SPEED.value

_tuple = tuple.__new__
"""Makes a balance at half the cost of calling its class."""

_CALM: Final = 0.7
"""Stiffness of the energy-permitted spring over the one whose lead alone uses up the damping cap.

k T^2 / m is then 0.48 at delay 0 and 0.084 at delay 1; the sampled spring with its lead turns unstable slightly above.
"""
_LEAD_ROOM: Final = 1.75
"""Lead and damping together over the damping cap: in contact the hold's own negative damping takes the excess."""
_LONGEST_WINDOW: Final = 0.02
"""Of the velocity from a coarse encoder [s]."""
_NO_CAP: Final = 1e12
"""Of the damping when the moving mass is not known [N*s/m or N*m*s/rad]: finite, so that at rest it gives no force."""
_FADE: Final = 0.8
"""Share of the device's past dissipation that still counts after another hold out of contact."""


class GuardedParameters(Parameters):
    """What the certificates rest on. Mass and damping of the device are properties of the loop."""

    hand_force: Annotated[float, quantity("N", "N*m", ge=0.0)] | None = 0.0
    """Largest force with which the hand pulls along the torque: out of a wall, into it only where a damper makes it
    stick. None: the certificate is not used."""
    hand_speed: Annotated[float, quantity("m/s", "rad/s", gt=0.0)] | None = None
    """Largest speed of the hand. None: the certificate is not used. Alone it begins only with a credit."""
    credit: Annotated[float, quantity("J", ge=0.0)] = 0.0
    """Energy that may be given out before any came in: the promise becomes sum(h_i) >= -credit."""
    alpha: Alpha = 0.0
    """Modulated damping per joule of surplus (eq. 19), always with its unit; 0 leaves the surplus standing."""
    lead: Annotated[float, quantity("count", ge=0.0, le=1.0)] = 0.5
    """Prediction beyond the delay, in holds: 0.5 aims at the middle of the hold."""
    lost_frames: Annotated[int, quantity("count", ge=0, le=16)] = 0
    """Consecutive cycles without a new torque at the drive that the certificates survive; each costs stiffness."""


class Guarded:
    """An environment rendered as far as the certificates allow."""

    parameters_type: ClassVar[type[Parameters]] = GuardedParameters

    def __init__(self, environment: Environment, parameters: GuardedParameters, loop: LoopProperties) -> None:
        sample_time, mass, damping = loop.sample_time, loop.moving_mass, loop.device_damping or None
        self.lost_frames = parameters.lost_frames
        response = None
        if parameters.hand_force is not None and mass is not None:
            most = loop.device_damping_bound or 0.0
            response = displacement_response(sample_time, mass, parameters.hand_force, damping or 0.0, most)
        elif damping is None and parameters.hand_speed is None:
            raise ParameterError(
                "guarded: got neither moving_mass with hand_force, nor device_damping, nor hand_speed, expected one of "
                "them; without any no torque can be certified: declare what is known or choose another algorithm"
            )
        self._environment, self._relaxes = environment, environment.relaxes
        self._sample_time, self._delay = sample_time, loop.delay
        self._credit, self._alpha, self._quantum = parameters.credit, parameters.alpha, loop.torque_quantum
        self._lead = parameters.lead + loop.delay
        self._cap = min(_NO_CAP, damping_cap(loop.delay, mass, sample_time))
        self._damping = min(environment.damping, self._cap)
        self._lead_room = (_LEAD_ROOM - 1.0) * self._cap
        self._calm_stiffness = _CALM * self._cap / (sample_time * (0.5 + loop.delay)) if response else 0.0
        self._damped_stiffness = 2.0 * damping / (sample_time * (1 + loop.delay)) if damping else 0.0
        self._path = (parameters.hand_speed or 0.0) * sample_time * (1 + loop.delay)
        self._bound = TorqueBound(
            Declared(sample_time, response, damping, parameters.hand_speed, loop.encoder_count, parameters.lost_frames),
            loop.delay,
        )
        self._window = None
        if loop.encoder_count:
            self._window = AdaptiveWindow(sample_time, loop.encoder_count, max(2, round(_LONGEST_WINDOW / sample_time)))
        self._in_flight = CommandsInFlight(loop.delay, loop.torque_limit)
        self.reset()

    def reset(self) -> None:
        """Forgets everything: zero stored energy, no torque in flight, no last position."""
        self._bound.reset()
        self._in_flight.reset()
        self._under_way = deque((0.0,) * self._delay, maxlen=self._delay)
        self._skipped: tuple[float, ...] = ()
        self._zone = 0
        self._state = self._stored = self._h_s = self._h_dis = self._kept_back = 0.0

    def hold(self) -> EnergyBalance:
        """Repeats the last command for want of a position; see `Controller.hold`.

        The next `step` books the displacement over all holds with the torque read back, less what that leaves open.
        """
        in_flight = self._in_flight
        self._skipped += (in_flight.lose_hold(),)
        torque = in_flight.torques[-1]
        self._under_way.append(torque)
        return AT_REST._replace(torque=torque, h_s=self._h_s, h_dis=self._h_dis, branch=_HELD, state=self._stored)

    def step(self, position: float, torque_applied: float) -> EnergyBalance:
        """Books the hold that ended; see `Controller.step`."""
        hold = self._ended_hold(position, torque_applied)
        environment = self._environment
        zone, before = environment.contact(position), self._zone
        self._zone = zone
        if hold is None:
            return AT_REST
        displacement, damper, modulated, holds, unsure = hold
        same = zone == before
        last = self._state if same else 0.0
        state = environment.true_state(position, displacement, last) if zone else 0.0
        ceiling = environment.stored_energy(state) if zone else 0.0
        h_i = interaction_energy(torque_applied, displacement) - unsure
        h_pas = modulated * displacement
        h_r, deficit, leak, paid = self._book(h_i, h_pas, damper * displacement, ceiling)
        torque = rendered = 0.0
        certificate = _UNBOUNDED
        if zone:
            if self._relaxes:
                state, ceiling, lost = self._relax(state, ceiling)
                h_r += lost
            spring = environment.effort(state)
            travel, inside = self._motion(state, last, displacement, holds, same)
            torque, rendered, certificate = self._render(state, travel, inside, spring, ceiling)
            branch = _START if not same else _STICKY if h_i > 0.0 and displacement * spring < 0.0 else _EXACT
        else:
            self._in_flight.send(0.0, 0.0, 0.0)
            if self._bound.dissipated:
                self._fade()
            branch = _EXIT if before or h_i or leak else _FREE
        if deficit > 0.0:
            branch = _DEPLETED
        self._under_way.append(torque)
        self._state = state
        h_s = self._h_s
        self._stored = stored = state if h_s == ceiling else environment.state_of_energy(h_s, state)
        return _tuple(EnergyBalance, (
            torque, h_i, h_pas, h_i - h_pas, h_r, h_s, self._h_dis, 0.0, deficit, leak, paid, branch, rendered,
            certificate, stored,
        ))  # fmt: skip

    def _ended_hold(self, position: float, torque_applied: float) -> tuple[float, float, float, int, float] | None:
        """Returns (displacement, damper effort, modulated effort, holds, energy unsure), None at the first sample."""
        try:
            hold = self._in_flight.ended_hold(position, torque_applied)
        except ControlError:
            self.reset()
            raise
        window = self._window
        if hold is None:
            self._skipped = ()
            if window is not None:
                window.restart(position)
            return None
        displacement, damper, modulated = hold
        if not self._skipped:
            self._bound.ended_hold(displacement, torque_applied)
            if window is not None:
                window.update(position)
            return displacement, damper, modulated, 1, 0.0
        holds = 1 + len(self._skipped)
        unsure = self._bound.ended_gap(displacement, (*self._skipped, torque_applied))
        self._skipped = ()
        if window is not None:
            window.restart(position)
            window.velocity = displacement / (holds * self._sample_time)
        return displacement, 0.0, 0.0, holds, unsure

    def _relax(self, state: float, ceiling: float) -> tuple[float, float, float]:
        """Returns (state, energy there, energy dissipated) after one hold of internal relaxation."""
        relaxed = self._environment.relaxed(state, self._sample_time)
        left = self._environment.stored_energy(relaxed)
        lost = min(self._h_s, max(0.0, ceiling - left))
        self._h_s -= lost
        self._kept_back += lost
        return relaxed, left, lost

    def _motion(self, state: float, last: float, displacement: float, holds: int, same: bool) -> tuple[float, float]:
        """Returns the motion per hold of the state and of the damper inside the contact [m or rad]."""
        window = None if self._relaxes else self._window
        if same:
            if window is None:
                return (state - last) / holds, displacement / holds
            smooth = window.velocity * self._sample_time
            return smooth, smooth
        inside = (state - self._environment.admissible(state - displacement, state)) / holds
        return displacement / holds if window is None else window.velocity * self._sample_time, inside

    def _fade(self) -> None:
        bound, energy = self._bound, self._h_s - self._h_dis
        bound.keep(energy, _FADE * max(0.0, energy + bound.dissipated))

    def _book(self, h_i: float, h_pas: float, damped: float, ceiling: float) -> tuple[float, float, float, float]:
        """Books one hold into store and surplus; returns (h_r, deficit, leak, paid) [J].

        Args:
            h_i: Interaction energy of the hold [J].
            h_pas: Part of it taken by the modulated damper [J].
            damped: Damper effort inside the applied torque times the displacement [J].
            ceiling: What the environment stores at its true state [J]; more is not kept.
        """
        h_s, surplus = self._h_s + h_i - h_pas, self._h_dis - h_pas
        slack = 0.0
        if damped > 0.0 or h_s > ceiling:
            slack = self._bound.free(h_s - surplus + self._credit, self._under_way)
            if slack > h_s:
                slack = h_s
        elif h_s >= 0.0:  # nothing is dissipated, leaked or lacking: nothing is to be settled
            self._h_s, self._h_dis = h_s, surplus
            return 0.0, 0.0, 0.0, 0.0
        self._h_s, self._h_dis, h_r, deficit, leak, paid = settle(h_s, surplus, damped, ceiling, slack)
        self._kept_back += h_r + leak - paid
        return h_r, deficit, leak, paid

    def _certain(self) -> float:
        """Returns the energy [J] that the next torques may take out.

        What was dissipated or leaked is not available again, but it covers what the encoder leaves unsure: (4) holds
        for the energy as booked, (3) for the true one.
        """
        energy = self._h_s - self._h_dis + self._credit
        if self._window is not None:
            lacking = self._bound.unsure - self._kept_back
            if lacking > 0.0:
                energy -= lacking
        return energy

    def _render(
        self, state: float, travel: float, displacement: float, spring: float, ceiling: float
    ) -> tuple[float, float, int]:
        """Sends the torque for the next free hold; returns (torque, damping rendered, certificate)."""
        velocity = displacement / self._sample_time
        energy, environment, bound = self._certain(), self._environment, self._bound
        ahead = environment.admissible(state + self._lead * travel, state)
        lead = environment.effort(ahead) - spring
        spring, lead, damper, covered = self._efforts(spring, lead, velocity, energy, ceiling)
        rendered = damper / velocity if velocity else self._damping
        modulated = 0.0
        if self._alpha and self._h_dis > 0.0 and velocity:
            extra = modulated_damping(self._alpha, self._h_dis, rendered, self._cap, displacement, self._sample_time)
            modulated = extra * velocity
            rendered += extra
        torque = -(spring + lead + damper + modulated)
        size = abs(torque)
        certificate = _UNBOUNDED
        if size:
            by_force, by_damping, by_speed = bound.largest(1.0 if torque > 0.0 else -1.0, energy, self._under_way)
            largest = by_force if by_force > by_damping else by_damping
            if by_speed > largest:
                largest = by_speed
            if size > largest:
                share = largest / size
                torque, damper, modulated, rendered = (
                    torque * share,
                    damper * share,
                    modulated * share,
                    rendered * share,
                )
                size, covered = largest, False
            if not covered:
                certificate = _BY_DAMPING if by_damping >= size else _BY_FORCE if by_force >= size else _BY_SPEED
            if self._quantum:
                torque = int(torque / self._quantum) * self._quantum  # towards 0
        self._in_flight.send(torque, damper, modulated)
        return torque, rendered, certificate

    def _efforts(
        self, spring: float, lead: float, velocity: float, energy: float, ceiling: float
    ) -> tuple[float, float, float, bool]:
        """Returns efforts of spring, lead and damper [N or N*m], and whether the account covers all of them."""
        damper = self._damping * velocity
        bound, size, speed = self._bound, abs(spring), abs(velocity)
        room = self._cap * speed
        permitted = 2.0 * self._calm_stiffness * energy
        if self._damped_stiffness:
            bound.keep(energy, ceiling + 0.5 * (spring + lead + damper) ** 2 / self._damped_stiffness)
            with_device = 2.0 * self._damped_stiffness * (energy + bound.dissipated)
            if with_device > permitted:
                permitted = with_device
        if self._path and energy > 0.0:
            permitted = max(permitted, (energy / self._path) ** 2)
        covered = permitted >= size * size
        if not covered:
            held = math.sqrt(permitted) if permitted > 0.0 else 0.0
            if velocity * spring > 0.0:
                catch_up = min(size - held, room)
                held += catch_up
                room -= catch_up
            held = math.copysign(held, spring)
            # moving out, the lead may stick as much as the damper does, and a pure spring never
            if lead * spring < 0.0 and abs(lead) > abs(held) + abs(damper):
                lead = math.copysign(abs(held) + abs(damper), lead)
            spring = held
        if abs(damper) > room:
            damper, covered = math.copysign(room, damper), False
        room += self._lead_room * speed - abs(damper)
        if abs(lead) > room:
            lead = math.copysign(room, lead)
        return spring, lead, damper, covered
