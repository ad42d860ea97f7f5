"""The simulated motor and hand behind one drive: exact under a constant torque, with the true energy of each part.

Between two SYNCs the torque is constant and the plant piecewise affine, so a hold is a few matrix-vector products and
every energy a quadratic form of the state (`hybrid_automaton.py`). Forces that are not piecewise affine are held over
substeps of this core (`splitting.py`). A hold that no guard can end is two products; a small plant without guards is
written out in floats (`flat.py`). A plant contains only what its parameters name. Time is an integer number of ticks of
T / 2^24 since the plant's epoch, so that k whole sample times are exactly k steps.
"""

import sys
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Final

import numpy as np

from canhaptic.errors import EventLimitError, OwnCodeError, ParameterError
from canhaptic.signals import PlantEnergy
from canhaptic.sim.plant import AccuracyParameters
from canhaptic.sim.plant.assembly import LEAST_MASS, MOTOR, Body, LinearPart, PlantModel, Rows, collect
from canhaptic.sim.plant.effects import Effect
from canhaptic.sim.plant.flat import FlatAutomaton, can_be_flat
from canhaptic.sim.plant.hybrid_automaton import HOLDS, AutomatonClock, HybridAutomaton
from canhaptic.sim.plant.propagator import TICKS, Array
from canhaptic.sim.plant.user import PLACE, UserParameters
from canhaptic.units import Parameters, quantity

if TYPE_CHECKING:
    from canhaptic.sim.plant.hybrid_automaton import Timetable
    from canhaptic.sim.plant.splitting import Splitting


_tuple: Final = tuple.__new__  # makes the energies at half the cost of calling their class
_LARGEST: Final = sys.float_info.max
_WORTH_LOOKING: Final = 8  # holds without events ahead: a look costs as much as two that are judged
_TIDY: Final = TICKS << 10
"""Ticks between two calls of `HybridAutomaton.tidy`: 1024 sample times, independent of reads in between."""


class PlantParameters(Parameters):
    """The moving mass of one axis, as seen by the encoder."""

    mass: Annotated[float, quantity("kg", "kg*m^2", ge=LEAST_MASS, le=1e6)]
    """Mass (linear axis) or inertia (rotary axis) that moves with the encoder."""
    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e6)] = 0.0
    """Viscous friction of the bearings."""
    initial_position: Annotated[float, quantity("m", "rad", ge=-1e3, le=1e3)] = 0.0
    """Initial position of the plant."""
    initial_velocity: Annotated[float, quantity("m/s", "rad/s", ge=-1e3, le=1e3)] = 0.0
    """Initial velocity of the plant."""

    def add_to(self, scene: PlantModel) -> None:
        """Add the motor's body and its bearings."""
        self.add_body(scene, "motor")
        scene.parts.append(LinearPart("motor", self._write))

    def add_body(self, scene: PlantModel, work: str) -> None:
        """Add the body, and the energy accounts of its motor and its bearings."""
        scene.add_state("position", self.initial_position)
        scene.add_state("velocity", self.initial_velocity)
        scene.bodies.append(Body("motor", self.mass, "velocity", (("position", 1.0),)))
        scene.works[work] = "motor"
        if self.damping:
            scene.works["bearings"] = "dissipated"

    def _write(self, rows: Rows) -> None:
        velocity, torque = rows.velocity(MOTOR), rows.row(**{rows.scene.motor_torque: 1.0})
        rows.forces[MOTOR] += torque
        rows.add_power("motor", torque, velocity)
        self.write_body(rows)

    def write_body(self, rows: Rows) -> None:
        """Add the motion of the body, its bearings, and the force that is held over a substep."""
        velocity = rows.velocity(MOTOR)
        rows.set_rate("position", velocity)
        rows.forces[MOTOR] -= self.damping * velocity
        if self.damping:
            rows.add_power("bearings", self.damping * velocity, velocity)
        if rows.scene.efforts:
            rows.set_rate("travel", velocity)
            rows.forces[MOTOR] += rows.row(effort=1.0)


class Plant(AutomatonClock):
    """One simulated axis, moved by a torque that is constant from call to call.

    The plant is at rest until `begin(now)`; from then on its clock never stops.

    Args:
        parameters: Mass and bearings.
        user: The hand; None for a free handle.
        effects: Effects of `canhaptic.sim.plant.effects`, in the order of the scene.
        sample_time_ns: T [ns]; a whole sample time is cheapest.
        seed: Seed of every random effect.
        accuracy: Accuracy of events and substeps; None: the defaults.

    Attributes:
        position: True position of the motor [m or rad].
        encoder_position: Position with the effects of the encoder; the value that a drive reads.
        has_ideal_encoder: Whether the encoder has no effects, so that both positions agree.
        is_exact: Whether every effect is solved exactly between events.
        is_linear: Whether a hold is a single linear flow: no guards, efforts, schedule or commands.
        stored_at_start: Kinetic and elastic energy at the start [J].
        state_names: Names of all states of the scene.
    """

    def __init__(
        self,
        parameters: PlantParameters,
        user: UserParameters | None,
        effects: Sequence[Effect],
        sample_time_ns: int,
        seed: int = 0,
        accuracy: AccuracyParameters | None = None,
    ) -> None:
        super().__init__(sample_time_ns)
        self.parameters = parameters
        self.user = user
        self.effects = tuple(effects)
        self.accuracy = accuracy or AccuracyParameters()
        self.seed = seed
        self.scene = collect(parameters, user, effects, sample_time_ns * 1e-9)
        self.has_ideal_encoder = not self.scene.encoders
        kind = FlatAutomaton if can_be_flat(self.scene) else HybridAutomaton
        self._machine = kind(self.scene, self.accuracy.max_events, self.accuracy.event_bits)
        self._period = self._machine.mover()
        self._splitting: Splitting | None = None
        self.is_exact = not self.scene.efforts
        self._timetable: Timetable | None = None
        self._hold = self._chosen_hold()
        self._moves = self._hold  # until own code fails: then the body stays, so that the drives can be stopped
        self.is_linear = self._hold == self._linear_hold
        self._is_flat = self.is_linear or self._hold == self._commanded_hold
        self._passing = min((command.passes for command in self.scene.commands), default=_LARGEST)
        self._looks_ahead = self._passing >= 0.0 and not (self._is_flat or self.scene.efforts)
        kept = [name for command in self.scene.commands for name in command.state_names]
        kept += [name for effort in self.scene.efforts for name in effort.state_names]
        self.state_names = (*self.scene.names, *kept)
        self.reset()

    def __repr__(self) -> str:
        effects = ", ".join(type(effect).__name__ for effect in self.effects) or "no effects"
        return f"<{type(self).__name__}: {self.parameters.mass:g} kg or kg*m^2, {effects}>"

    def _chosen_hold(self) -> Callable[[int, float], None]:
        """Function that moves this plant by a hold, specialised to its effects."""
        scene, machine = self.scene, self._machine
        has_guards = any(part.has_guards for part in scene.parts)
        is_timed = bool(scene.schedule or scene.settings)
        if not (has_guards or scene.efforts or is_timed):
            return self._commanded_hold if scene.commands else self._linear_hold
        run: Callable[[int], object] = machine.run if has_guards else machine.run_free
        if scene.efforts:
            from canhaptic.sim.plant.splitting import Splitting

            self._splitting = Splitting(machine, self.accuracy.substeps)
            run = self._splitting.run
        if is_timed:
            from canhaptic.sim.plant.hybrid_automaton import Timetable

            self._timetable = Timetable(machine, run)
            run = self._timetable.run
        self._run = run
        return self._general_hold

    def reset(self) -> None:
        """Return to the initial state, before `begin`, with all energies zero."""
        self._machine.reset()
        self._hold = self._moves
        for keeper in (*self.scene.commands, self._splitting, self._timetable):
            if keeper:
                keeper.reset()
        self.stored_at_start = self._stored()
        self._epoch: int | None = None
        self.tick = 0
        self._next_tidy = _TIDY
        self._pause = 0 if self._looks_ahead else _TIDY  # tick at which `_look` is due
        self._free_torque = self._passing if self._is_flat else -1.0  # until then one product is the hold within it
        self._largest, self._wait = 0.0, 1
        self._next_period = -1  # [ns] end of the sample time that begins at the tick; -1 inside a sample time
        self.position = self._machine.value(0)

    @property
    def velocity(self) -> float:
        """True velocity of the motor [m/s or rad/s]."""
        return self._machine.value(1)

    @property
    def motor_torque(self) -> float | None:
        """Torque of the motor after the current loop [N*m or N]; None without one: the torque is then the one held."""
        names = self.scene.names
        return self._machine.value(names.index("motor_torque")) if "motor_torque" in names else None

    @property
    def encoder_position(self) -> float:
        """Position that the encoder reports [m or rad]; repeated readings at one time agree."""
        position = self.position
        for encoder in self.scene.encoders:
            position = encoder.read(position, self.tick, self.seed)
        return position

    def set_states(self, values: Mapping[str, float]) -> None:
        """Set states of the hand for the following holds; allowed between two holds only.

        Args:
            values: New values by the name of the state, for a `GuidedHand` or a `PointerHand`.

        Raises:
            ParameterError: A value is not finite; no state is changed.
        """
        for name, value in values.items():
            self.require_finite(name, (value,))
        self._machine.set_states(values)
        if self._looks_ahead:
            self._free_torque = -1.0  # the look-ahead rested on the old place

    def move_hand(self, place: float) -> None:
        """Move a `PointerHand` to a position [m or rad] for the following holds; allowed between two holds only."""
        self.set_states({PLACE: place})

    @property
    def products(self) -> int:
        """Number of core steps tried since the start, a machine-independent cost."""
        return self._machine.products

    def begin(self, now: int) -> None:
        """Start the clock: `now` [ns] is the epoch, the state there is the initial one. Later calls change nothing."""
        if self._epoch is None:
            self._next_period = now + self.sample_time_ns
        super().begin(now)

    def advance_to(self, now: int, torque: float) -> None:
        """Move the plant to `now` under a torque that was constant since the last call; before `begin` it is at rest.

        Args:
            now: Time [ns] on the clock of `begin`; rounded to a tick of T / 2^24.
            torque: Torque held by the actuator since the last call [N or N*m].

        Raises:
            ParameterError: `now` lies before the last call, or the torque is not finite.
            EventLimitError: One sample time has more events than `accuracy.max_events`.
        """
        if now == self._next_period:
            self.tick = tick = self.tick + TICKS
            self._next_period = now + self.sample_time_ns
            free = self._free_torque
            if -free <= torque <= free:
                self.position = self._period(torque)
            elif -_LARGEST <= torque <= _LARGEST:
                self._hold(TICKS, torque)
            else:
                raise self.not_finite("torque", torque)
            if tick >= self._pause:
                self._look()
        elif ticks := self.pass_until(now):
            if not -_LARGEST <= torque <= _LARGEST:
                raise self.not_finite("torque", torque)
            whole, inside = divmod(self.tick, TICKS)
            self._next_period = -1 if inside else (self._epoch or 0) + (whole + 1) * self.sample_time_ns
            self._hold(ticks, torque)
            if self.tick >= self._pause:
                self._look()

    def _look(self) -> None:
        """Tidy when due, and look ahead for holds that no guard can end."""
        if self.tick >= self._next_tidy:
            self._machine.tidy()
            self._next_tidy = self.tick - self.tick % _TIDY + _TIDY
        self._pause = self._next_tidy
        if self._looks_ahead:
            largest = min(2.0 * self._largest, self._passing)
            holds = self._machine.holds_without_events(largest) if self._next_period >= 0 else 0
            if self._timetable:
                holds = min(holds, self._timetable.holds_from(self.tick))
            if holds >= _WORTH_LOOKING:
                self._free_torque, self._wait = largest, 1
            else:
                self._free_torque, self._wait, holds = -1.0, min(2 * self._wait, HOLDS), self._wait
            self._pause = min(self._pause, self.tick + holds * TICKS)

    def run(self, torques: Array) -> Array:
        """Move by one sample time under each torque, as by `advance_to`, and return the positions after them.

        The plant begins at time 0 if it has not begun.

        Args:
            torques: Shape (n_holds,) [N or N*m].

        Raises:
            ParameterError: The plant was stopped inside a sample time.
            EventLimitError: One sample time has more events than `accuracy.max_events`.
        """
        self.begin(0)
        if self._next_period < 0:
            raise ParameterError(
                f"run: the plant is {self.tick % TICKS} of {TICKS} ticks into a sample time; "
                "advance it to the next sample first"
            )
        positions = np.empty(len(torques))
        for k, torque in enumerate(torques.tolist()):
            self.advance_to(self._next_period, torque)
            positions[k] = self.position
        return positions

    def energy(self) -> PlantEnergy:
        """Return the true energies since the start [J]."""
        motor, user, dissipated = self._machine.accounts()
        if self._splitting:
            work = self._splitting.work
            motor, user, dissipated = motor + work["motor"], user + work["user"], dissipated + work["dissipated"]
        return _tuple(PlantEnergy, (motor, user, dissipated, self._stored() - self.stored_at_start))

    def _stored(self) -> float:
        stored = self._machine.stored()
        return stored + self._splitting.stored(self._machine.value(0)) if self._splitting else stored

    def _linear_hold(self, ticks: int, torque: float) -> None:
        if ticks == TICKS:
            self.position = self._period(torque)
        else:
            self._free_hold(ticks, torque)

    def _free_hold(self, ticks: int, torque: float) -> None:
        self._machine.hold(ticks, torque)
        self.position = self._machine.value(0)

    def _commanded_hold(self, ticks: int, torque: float) -> None:
        duration = ticks * self.tick_time
        for command in self.scene.commands:
            torque = command.apply(torque, duration)
        self._linear_hold(ticks, torque)

    def _general_hold(self, ticks: int, torque: float) -> None:
        machine = self._machine
        try:
            for command in self.scene.commands:
                torque = command.apply(torque, ticks * self.tick_time)
            if self._looks_ahead:
                if ticks == TICKS and abs(torque) <= self._free_torque:
                    self.position = self._period(torque)
                    return
                self._expect(ticks, torque)
            if self._timetable:
                self._timetable.tick = self.tick - ticks
            machine.state[-2] = torque
            machine.allow_events(self.tick - ticks, self.tick)
            self._run(ticks)
        except EventLimitError as error:
            raise EventLimitError(error.most, error.state, f"plant {self._before}", error.products) from None
        except OwnCodeError as error:
            self._hold = self._stay
            raise OwnCodeError(error.program, error.what, self._before) from error
        self.position = machine.state.item(0)

    @property
    def _before(self) -> str:
        return f"before {self.tick * self.tick_time:.9g} s"

    def _stay(self, ticks: int, torque: float) -> None:
        """Stay where it is."""

    def _expect(self, ticks: int, torque: float) -> None:
        """Check a torque against the look-ahead, and end the look-ahead when it is larger or changes inside a hold."""
        self._largest = max(self._largest, abs(torque))
        if self._free_torque >= 0.0:
            self._free_torque = -1.0
            self._pause = 0 if ticks == TICKS else min(self._next_tidy, self.tick + HOLDS * TICKS)
