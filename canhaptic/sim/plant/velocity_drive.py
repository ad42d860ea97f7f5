"""The plant of an admittance display: a mass that a velocity loop moves, a force sensor, and the hand behind it.

    drive          M v' = f + F - friction,   f = c (r - v) + f_I,   f_I' = k (r - v),   r held from SYNC to SYNC
    sensor         F on the mass, from the grip: a spring and a damper between that mass and the mass behind the sensor
    behind it      the mass behind the sensor, and the hand

The loop is part of the piecewise-affine plant, so that a hold stays exact. With a torque limit its torque has three
modes and its integral, which is kept within the limit, three of its own. `energy` is the flow through the sensor: the
energy given out by the display (`motor`), brought by the hand, and dissipated and stored behind the sensor.

A simulated force sensor: the quantity that one value measures, and its errors.

true force -> first-order filter -> sample at the SYNC, or mean since the last -> gain, offset, drift, noise
           -> whole quanta -> late by whole samples -> frozen from some time on
"""

import math
from collections import deque
from collections.abc import Sequence
from random import Random
from typing import Annotated, ClassVar, Final, Literal

from canhaptic.signals import PlantEnergy
from canhaptic.sim.plant.accuracy_parameters import AccuracyParameters
from canhaptic.sim.plant.assembly import LEAST_MASS, MOTOR, Guard, LinearPart, Part, PlantModel, Rows
from canhaptic.sim.plant.effects import Effect
from canhaptic.sim.plant.effects.shaft_compliance import ShaftCompliance
from canhaptic.sim.plant.plant import Plant, PlantParameters
from canhaptic.sim.plant.propagator import TICKS, Array
from canhaptic.sim.plant.user import UserParameters
from canhaptic.units import Parameters, quantity

_NS_PER_S = 1e9


class SimulatedForceSensor(Parameters):
    """The errors of a simulated force sensor; an ideal one by default."""

    sampling: Literal["point", "mean", "impulse"] = "point"
    """Meaning of one value: the force at the SYNC, its mean since the last, or its integral since the start."""
    filter: Annotated[float, quantity("Hz", ge=0.0, le=1e6)] = 0.0
    """Corner of a first-order filter before the sample; 0: none."""
    gain: Annotated[float, quantity("1", ge=-100.0, le=100.0)] = 1.0
    """Force shown over true force; -1: a wrong sign."""
    offset: Annotated[float, quantity("N", "N*m", ge=-1e6, le=1e6)] = 0.0
    """Shown at no force."""
    drift: Annotated[float, quantity("N/s", "N*m/s", ge=-1e6, le=1e6)] = 0.0
    """Change of the offset from the start of the plant."""
    noise: Annotated[float, quantity("N", "N*m", ge=0.0, le=1e6)] = 0.0
    """Standard deviation of each value; it is cut at three of it."""
    quantum: Annotated[float, quantity("N", "N*m", ge=0.0, le=1e6)] = 0.0
    """Step of the values, in addition to the step of the object that carries them."""
    latency: Annotated[int, quantity("count", ge=0, le=16)] = 0
    """Delay of a value in whole samples."""
    freeze_at: Annotated[float, quantity("s", ge=0.0, le=1e6)] | None = None
    """Time from which the value stays as it is; None: never."""
    fault_offset: Annotated[float, quantity("N", "N*m", ge=-1e6, le=1e6)] = 0.0
    """A step of the offset at `fault_at`."""
    fault_at: Annotated[float, quantity("s", ge=0.0, le=1e6)] = 0.0
    """Time of that step."""


class ForceReading:
    """The values of one sensor, taken once at every SYNC.

    Args:
        sensor: Errors of the sensor.
        seed: Seed of the noise.
    """

    def __init__(self, sensor: SimulatedForceSensor, seed: int) -> None:
        self._sensor, self._seed = sensor, seed
        self.reset()

    def reset(self) -> None:
        """Return to the start."""
        self._random = Random(self._seed)
        self._late = deque([0.0] * self._sensor.latency)
        self._impulse, self._taken_at = 0.0, -1
        self._error = 0.0  # integral of what a running impulse has too much [N*s or N*m*s]
        self.value = 0.0

    def take(self, elapsed: int, force: float, impulse: float) -> float:
        """Reading at a SYNC [N or N*m; an impulse: N*s or N*m*s].

        Args:
            elapsed: Time since the start of the plant [ns]; repeated calls for one time give the same value.
            force: Force at this time, behind the filter [N or N*m].
            impulse: Integral of the force since the start [N*s or N*m*s].
        """
        if elapsed == self._taken_at:
            return self.value
        sensor, last = self._sensor, self._taken_at
        change, self._impulse, self._taken_at = impulse - self._impulse, impulse, elapsed
        time = elapsed / _NS_PER_S
        if sensor.freeze_at is not None and time >= sensor.freeze_at:
            return self.value
        error = sensor.offset + sensor.drift * time
        if time >= sensor.fault_at:
            error += sensor.fault_offset
        if sensor.noise:
            deviation = self._random.gauss(0.0, 1.0)
            error += sensor.noise * (-3.0 if deviation < -3.0 else 3.0 if deviation > 3.0 else deviation)
        if sensor.sampling == "impulse":
            self._error += error * (elapsed - max(last, 0)) / _NS_PER_S
            shown = sensor.gain * impulse + self._error
        else:
            if sensor.sampling == "mean":
                since = elapsed - last if last > 0 else elapsed
                force = change * _NS_PER_S / since if since else 0.0
            shown = sensor.gain * force + error
        if sensor.quantum:
            shown = round(shown / sensor.quantum) * sensor.quantum
        if self._late:
            self._late.append(shown)
            shown = self._late.popleft()
        self.value = shown
        return shown


_tuple: Final = tuple.__new__  # makes an energy at half the cost of calling its class
_LOOP: Final = "velocity_loop"
_SENSOR: Final = "force_sensor"
_INTEGRAL: Final = "loop_integral"
_ON_THE_DEVICE: Final = frozenset(
    {_LOOP, _SENSOR, "bearings", "viscous_friction", "coulomb_friction", "stribeck_friction", "lugre_friction"}
)
"""Work terms of the parts before the sensor."""


class VelocityLoopParameters(Parameters):
    """The velocity loop of a simulated drive: torque = gain (r - v) + integral of integral_gain (r - v)."""

    gain: Annotated[float, quantity("N*s/m", "N*m*s/rad", gt=0.0, le=1e9)]
    """Proportional gain c; 2 pi f M for a bandwidth of f."""
    integral_gain: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0, le=1e12)] = 0.0
    """Integral gain k; of a position loop with velocity feed-forward: its gain times `gain`."""
    torque_limit: Annotated[float, quantity("N", "N*m", gt=0.0, le=1e9)] | None = None
    """Largest torque of the loop, and of its integral; 0x6072 can lower it. None: neither is limited, by nothing."""


class GripParameters(Parameters):
    """Grip between the sensor and the hand."""

    mass: Annotated[float, quantity("kg", "kg*m^2", ge=LEAST_MASS, le=1e6)]
    """Behind the sensor: handle, and the part of the hand that moves with it."""
    stiffness: Annotated[float, quantity("N/m", "N*m/rad", gt=0.0, le=1e10)] = 1e5
    """Stiffness of sensor and grip together."""
    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e6)] = 0.0
    """Damping of sensor and grip together."""


class AdmittanceSimulation(Parameters):
    """Simulation parameters of an admittance display in addition to mass, hand and effects."""

    loop: VelocityLoopParameters
    """The drive's own velocity loop."""
    grip: GripParameters
    """Between sensor and hand."""
    sensor: SimulatedForceSensor = SimulatedForceSensor()
    """The force sensor and its errors."""


class _DrivenMass(PlantParameters):
    """The mass before the sensor, moved by a velocity loop."""

    loop: VelocityLoopParameters

    def add_to(self, scene: PlantModel) -> None:
        """Add the mass, its bearings and the loop."""
        self.add_body(scene, _LOOP)
        scene.parts.append(LinearPart("mass", self.write_body))
        scene.parts.append(_Loop(self.loop))
        if self.loop.integral_gain:
            scene.add_state(_INTEGRAL)
            scene.parts.append(_Integral(self.loop))


class _Loop(Part):
    """The loop as a part: following, limited on either side, or without power."""

    name: str = _LOOP
    modes: tuple[str, ...] = ("follows", "upper", "lower", "off")

    def __init__(self, loop: VelocityLoopParameters) -> None:
        self._loop = loop
        self.has_guards = loop.torque_limit is not None

    def _demand(self, rows: Rows) -> Array:
        gain = self._loop.gain
        demand = rows.row(torque=gain) - gain * rows.velocity(MOTOR)
        return demand + rows.row(**{_INTEGRAL: 1.0}) if self._loop.integral_gain else demand

    def assemble(self, rows: Rows, mode: str) -> None:
        """Add the torque of the loop."""
        velocity, limit = rows.velocity(MOTOR), self._loop.torque_limit or 0.0
        if mode == "off":
            return
        force = self._demand(rows) if mode == "follows" else rows.row(one=limit if mode == "upper" else -limit)
        rows.forces[MOTOR] += force
        rows.add_power(_LOOP, force, velocity)

    def guards(self, rows: Rows, mode: str) -> Sequence[Guard]:
        """Guards to and from the limit of the torque."""
        limit = self._loop.torque_limit
        if limit is None or mode == "off":
            return ()
        demand, most = self._demand(rows), rows.row(one=limit)
        if mode == "follows":
            return (Guard(most - demand, "upper"), Guard(most + demand, "lower"))
        return (Guard((demand if mode == "upper" else -demand) - most, "follows"),)


class _Integral(_Loop):
    """The integral of the loop as a part: free, or at the limit of the torque."""

    name, modes = _INTEGRAL, ("free", "upper", "lower")

    def assemble(self, rows: Rows, mode: str) -> None:
        """Add the rate of the integral."""
        gain = self._loop.integral_gain
        if mode == "free":
            rows.set_rate(_INTEGRAL, rows.row(torque=gain) - gain * rows.velocity(MOTOR))

    def guards(self, rows: Rows, mode: str) -> Sequence[Guard]:
        """Guards to and from the limit."""
        if self._loop.torque_limit is None:
            return ()
        most, value = rows.row(one=self._loop.torque_limit), rows.row(**{_INTEGRAL: 1.0})
        lag, place = rows.row(torque=1.0) - rows.velocity(MOTOR), rows.index[_INTEGRAL]
        if mode == "free":
            return (Guard(most - value, "upper", ((place, most),)), Guard(most + value, "lower", ((place, -most),)))
        return (Guard(lag if mode == "upper" else -lag, "free"),)


class _Sensor(Part):
    """Force between mass and grip: its impulse, its filtered value, and the work through it."""

    order: ClassVar[int | None] = None
    rank: ClassVar[int] = 9
    type: ClassVar[str] = _SENSOR
    name, modes = _SENSOR, ("linear",)

    def __init__(self, grip: GripParameters, corner: float) -> None:
        self._grip, self._corner = grip, corner

    def add_to(self, scene: PlantModel) -> None:
        """Add the sensor to a scene."""
        scene.add_state("impulse")
        if self._corner:
            scene.add_state("filtered_force")
        scene.works[_SENSOR] = "user"
        scene.parts.append(self)

    def assemble(self, rows: Rows, mode: str) -> None:
        """Add the integral of the force, its filter and its work."""
        grip, rate = self._grip, rows.velocity(MOTOR) - rows.velocity(MOTOR + 1)
        force = rows.row(twist=-grip.stiffness) - grip.damping * rate
        rows.set_rate("impulse", force)
        rows.add_power(_SENSOR, force, rows.velocity(MOTOR))
        if self._corner:
            rows.set_rate("filtered_force", self._corner * (force - rows.row(filtered_force=1.0)))


class AdmittancePlant(Plant):
    """One simulated axis with a velocity loop and a force sensor; the input of a hold is the commanded velocity.

    Args:
        parameters: Mass before the sensor, and its bearings.
        display: Loop, grip and sensor.
        user: The hand; None for a free handle.
        effects: Further effects, on the mass before the sensor.
        sample_time_ns: T [ns].
        seed: Seed of everything random.
        accuracy: Events and substeps; the defaults when None.

    Attributes:
        reading: Reading of the force sensor.
    """

    def __init__(
        self,
        parameters: PlantParameters,
        display: AdmittanceSimulation,
        user: UserParameters | None,
        effects: Sequence[Effect],
        sample_time_ns: int,
        seed: int = 0,
        accuracy: AccuracyParameters | None = None,
    ) -> None:
        self.display, self._shift, self._torque_offset = display, 0.0, 0.0
        self._made_of = (parameters, user, tuple(effects), sample_time_ns, seed, accuracy)
        self.reading = ForceReading(display.sensor, seed)
        self._half_mass = 0.5 * parameters.mass
        driven = _DrivenMass(**parameters.model_dump(), loop=display.loop)
        grip = display.grip
        self._stiffness, self._damping = grip.stiffness, grip.damping
        behind = ShaftCompliance(stiffness=grip.stiffness, damping=grip.damping, load_mass=grip.mass)
        sensor = _Sensor(grip, 2.0 * math.pi * display.sensor.filter)
        super().__init__(driven, user, [behind, *effects, sensor], sample_time_ns, seed, accuracy)

    def reset(self) -> None:
        """Return to the initial state, before `begin`, with all energies zero."""
        scene = self.scene
        names = list(scene.works)
        self._sensor_work, self._user_work = names.index(_SENSOR), names.index("hand") if "hand" in names else -1
        self._losses = [n for n, name in enumerate(names) if name not in _ON_THE_DEVICE and name != "hand"]
        states = list(scene.names)
        self._force_state = states.index("filtered_force") if "filtered_force" in states else -1
        self._places = [states.index(name) for name in ("impulse", "twist", "velocity", "load_velocity")]
        self._integral = states.index(_INTEGRAL) if _INTEGRAL in states else -1
        self._moves = self._hold
        self._is_on = True
        super().reset()
        self.reading.reset()

    def power(self, *, on: bool) -> None:
        """Switch the power stage; without power the mass moves freely. Switching on clears the integral."""
        if on == self._is_on:
            return
        self._is_on = on
        self._machine.set_part_mode(_LOOP, "follows" if on else "off")
        if self._integral >= 0:
            self._machine.state[self._integral] = self._torque_offset
            self._machine.set_part_mode(_INTEGRAL, "free")
        self._free_torque = self._passing if on and self._is_flat else -1.0
        self._hold = self._moves if on or not self._is_flat else self._free_hold
        self._pause, self._wait = self.tick, 1

    def limit_torque(self, limit: float) -> None:
        """Lower the limit of the torque before the plant begins, as 0x6072 does; no effect without a limit.

        Args:
            limit: Largest torque [N or N*m].
        """
        most = self.display.loop.torque_limit
        if most is None or limit >= most or limit <= 0.0:
            return
        loop = self.display.loop.model_copy(update={"torque_limit": limit})
        parameters, user, effects, sample_time_ns, seed, accuracy = self._made_of
        display = self.display.model_copy(update={"loop": loop})
        AdmittancePlant.__init__(self, parameters, display, user, effects, sample_time_ns, seed, accuracy)

    def feed_forward(self, torque: float) -> None:
        """Add a torque to the loop's torque from now on, replacing the previous one, as 0x60B2 does.

        With an integral it is added to the integral; otherwise it is converted to an additional velocity command.

        Args:
            torque: Additional torque [N or N*m].
        """
        change, self._torque_offset = torque - self._torque_offset, torque
        if self._integral >= 0:
            self._machine.state[self._integral] += change
            self._pause, self._wait = self.tick, 1
        else:
            self._shift = torque / self.display.loop.gain

    def advance_to(self, now: int, torque: float) -> None:
        """Move to `now` [ns]; `torque` is the velocity commanded since the last call [m/s or rad/s]."""
        super().advance_to(now, torque + self._shift if self._shift else torque)

    def _free_hold(self, ticks: int, command: float) -> None:
        self._machine.state[-2] = command
        self._machine.run_free(ticks)
        self.position = self._machine.state.item(0)

    @property
    def force(self) -> float:
        """True force on the mass at the sensor [N or N*m]."""
        read, (_, twist, near, far) = self._machine.state.item, self._places
        return -self._stiffness * read(twist) - self._damping * (read(near) - read(far))

    def read_force(self) -> float:
        """Present reading of the sensor; see `ForceReading.take`."""
        read, elapsed = self._machine.state.item, self.tick * self.sample_time_ns // TICKS
        force = self.force if self._force_state < 0 else read(self._force_state)
        return self.reading.take(elapsed, force, read(self._places[0]))

    def energy(self) -> PlantEnergy:
        """Energy through the sensor since the start [J]; `motor` is the display's output."""
        works = self._machine.works()
        user = works[self._user_work] if self._user_work >= 0 else 0.0
        lost = 0.0
        for place in self._losses:
            lost += works[place]
        return _tuple(PlantEnergy, (-works[self._sensor_work], user, lost, self._stored() - self.stored_at_start))

    def _stored(self) -> float:
        """Energy stored behind the sensor [J]."""
        speed = self._machine.state.item(1)
        return super()._stored() - self._half_mass * speed * speed
