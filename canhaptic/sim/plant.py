"""Motor and user behind one drive: exact between two torques, with the energies each part truly took or gave.

Between two SYNCs the torque is constant and the plant is linear, so a whole sample time is one matrix-vector product
(`canhaptic.sim.propagator`) and every energy one quadratic form of the state at its start: no integration error for
any stiffness. Time is an integer number of ticks of T / 2^20 since the plant's epoch, so that k whole sample times are
exactly k steps.
"""

import math
from collections.abc import Sequence
from typing import Annotated, Final

import numpy as np

from canhaptic.errors import ParameterError
from canhaptic.parameters import Parameters, quantity
from canhaptic.signals import PlantEnergy
from canhaptic.sim.propagator import LEVELS, TICKS, Array, dyadic_flows
from canhaptic.sim.user import UserParameters

_USER: Final = 0  # row of the work of the hand
_VISCOUS: Final = 1  # row of the viscous loss


class PlantParameters(Parameters):
    """The moving mass of one axis, as seen by the encoder."""

    mass: Annotated[float, quantity("kg", "kg*m^2", gt=0.0, le=1e6)]
    """Mass (linear axis) or inertia (rotary axis) that moves with the encoder."""
    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e6)] = 0.0
    """Viscous friction of the bearings."""
    initial_position: Annotated[float, quantity("m", "rad", ge=-1e3, le=1e3)] = 0.0
    initial_velocity: Annotated[float, quantity("m/s", "rad/s", ge=-1e3, le=1e3)] = 0.0


class Plant:
    """One simulated axis: mass, friction and hand, moved by a torque that is constant from call to call.

    The plant stands still until `begin(now)`; from then on its clock never stops.

    Args:
        parameters: Mass and bearings.
        user: The hand; None when nobody holds the handle.
        effects: Effects of `canhaptic.sim.effects`, in the order of the scene.
        sample_time_ns: T [ns]; energies are cheapest and time is exact at whole multiples of it.
        seed: Of every random effect.

    Attributes:
        position: True position [m or rad].
    """

    def __init__(
        self,
        parameters: PlantParameters,
        user: UserParameters | None,
        effects: Sequence[Parameters],
        sample_time_ns: int,
        seed: int = 0,
    ) -> None:
        if effects:
            raise ParameterError(f"effects: got {len(effects)}, expected none; this plant is linear")
        if sample_time_ns < 1:
            raise ParameterError(f"sample time: got {sample_time_ns} ns, expected at least 1 ns; lower the rate")
        self.parameters = parameters
        self.user = user or UserParameters()
        self.sample_time_ns = sample_time_ns
        self.seed = seed
        names, rates, powers, shift = _linear_scene(parameters, self.user)
        self.state_names = tuple(names)
        flows, _ = dyadic_flows(rates, [], sample_time_ns * 1e-9)
        back = np.linalg.inv(shift)
        shifted_powers = [back.T @ power @ back for power in powers]
        _, works = dyadic_flows(shift @ rates @ back, shifted_powers, sample_time_ns * 1e-9)
        self._flows = [flow.dot for flow in flows]
        self._works = [np.concatenate([form @ shift for form in forms] + [shift]).dot for forms in works]
        self._size = len(names)
        self.reset()

    def reset(self) -> None:
        """Returns to the initial state, before `begin`, with all energies zero."""
        size, p, u = self._size, self.parameters, self.user
        self._state, self._next_state = np.zeros(size), np.zeros(size)
        self._state[:2] = p.initial_position, p.initial_velocity
        if u.motion:
            self._state[2:4] = math.sin(u.motion.phase), math.cos(u.motion.phase)
        self._state[size - 1] = 1.0
        self._rows = np.zeros(3 * size)  # the two work forms times the shifted state, then the shifted state
        self._row_sum = self._rows[: 2 * size].reshape(2, size).dot
        self._shifted = self._rows[2 * size :]
        self._work, self._totals = np.zeros(2), np.zeros(2)
        self._motor = 0.0
        self._epoch: int | None = None
        self._tick = 0
        self._next_period = -1  # [ns] end of the sample time that begins at _tick; -1 inside a sample time
        self.position = p.initial_position

    @property
    def velocity(self) -> float:
        """True velocity [m/s or rad/s]."""
        return float(self._state[1])

    @property
    def begun(self) -> bool:
        """True once the clock of the plant runs."""
        return self._epoch is not None

    def begin(self, now: int) -> None:
        """Starts the clock: `now` [ns] is the epoch, the state there is the initial one. Later calls change nothing."""
        if self._epoch is None:
            self._epoch = now
            self._next_period = now + self.sample_time_ns

    def advance_to(self, now: int, torque: float) -> None:
        """Moves the plant to `now` under a torque that was constant since the last call; still before `begin`.

        Args:
            now: Time [ns] on the clock that `begin` was given; rounded to a tick of T / 2^20.
            torque: Held by the actuator since the last call [N or N*m].

        Raises:
            ParameterError: `now` lies before the last call.
        """
        if now == self._next_period:
            self._state[-2] = torque
            self._move(0)
            self._tick += TICKS
            self._next_period = now + self.sample_time_ns
        else:
            self._advance_between(now, torque)

    def energy(self) -> PlantEnergy:
        """Returns the true energies since the start [J]."""
        p = self.parameters
        stored = 0.5 * p.mass * (self.velocity**2 - p.initial_velocity**2)
        return PlantEnergy(self._motor, float(self._totals[_USER]), float(self._totals[_VISCOUS]), stored)

    def _move(self, level: int) -> None:
        """Takes one step of T / 2^level and books its energies."""
        state, moved = self._state, self._next_state
        self._works[level](state, self._rows)
        self._row_sum(self._shifted, self._work)
        self._totals += self._work
        self._flows[level](state, moved)
        position = moved.item(0)
        self._motor += moved.item(-2) * (position - self.position)
        self.position = position
        self._state, self._next_state = moved, state

    def _advance_between(self, now: int, torque: float) -> None:
        """Advances by a time that is not just the next whole sample time."""
        if self._epoch is None:
            return
        period = self.sample_time_ns
        tick = ((now - self._epoch) * TICKS + period // 2) // period
        if tick < self._tick:
            raise ParameterError(f"time went back: got {now} ns, {self._tick - tick} ticks before the last call")
        self._state[-2] = torque
        for _ in range((tick - self._tick) >> LEVELS):
            self._move(0)
        rest = (tick - self._tick) & (TICKS - 1)
        for level in range(1, LEVELS + 1):
            if rest & (TICKS >> level):
                self._move(level)
        self._tick = tick
        whole, inside = divmod(tick, TICKS)
        self._next_period = -1 if inside else self._epoch + (whole + 1) * period


def _linear_scene(plant: PlantParameters, user: UserParameters) -> tuple[list[str], Array, list[Array], Array]:
    """Returns state names, F of dz/dt = F z, the power forms [hand, viscous loss] and the shift to the hand's rest.

    Work is evaluated about the rest of the hand: about q = 0 the squares of a stiff hand far from there would cancel
    (1e6 N/m at 10 mm: 50 J against the 0.1 J that flow).
    """
    names = ["position", "velocity"] + (["motion_sine", "motion_cosine"] if user.motion else []) + ["torque", "one"]
    size = len(names)
    hand = np.zeros(size)  # force of the hand as a row: F_hand = hand . z
    hand[0], hand[1], hand[-1] = -user.stiffness, -user.damping, user.stiffness * user.rest + user.push
    rates = np.zeros((size, size))
    if user.motion:
        omega, amplitude = 2.0 * math.pi * user.motion.frequency, user.motion.amplitude
        rates[2, 3], rates[3, 2] = omega, -omega
        hand[2], hand[3] = user.stiffness * amplitude, user.damping * omega * amplitude
        hand[-1] += user.stiffness * user.motion.offset
    rates[0, 1] = 1.0
    rates[1] = hand / plant.mass
    rates[1, 1] -= plant.damping / plant.mass
    rates[1, -2] = 1.0 / plant.mass
    velocity = np.eye(size)[1]
    work = 0.5 * (np.outer(hand, velocity) + np.outer(velocity, hand))
    shift = np.eye(size)
    shift[0, -1] = hand[-1] / hand[0] if hand[0] else 0.0
    return names, rates, [work, plant.damping * np.outer(velocity, velocity)], shift
