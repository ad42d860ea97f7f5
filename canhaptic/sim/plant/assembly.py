"""A plant before it is compiled: states, bodies, parts, and the rows they write for one mode.

The state is one vector z = [states..., torque, one]: the held torque and the constant 1 are components of it, so that
every force, rate and guard is a row (force = row . z) and every power a quadratic form z'Sz. A scene holds only what
its effects added; nothing is switched off at run time.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Final, Literal, NamedTuple, Protocol

import numpy as np

from canhaptic.errors import ParameterError
from canhaptic.own_results import FORCE, watch
from canhaptic.sim.plant.propagator import Array

Account = Literal["motor", "user", "dissipated"]

MOTOR: Final = 0  # index of the body that carries motor and encoder
LEAST_MASS: Final = 1e-12
"""Least mass of a body [kg or kg*m^2]: a lighter one would be accelerated beyond the resolution of floats."""


class Body(NamedTuple):
    """A moving mass. `position` names the states that add up to its position, with their factors."""

    name: str
    mass: float  # [kg or kg*m^2]
    velocity: str  # name of its velocity state
    position: tuple[tuple[str, float], ...]


class Guard(NamedTuple):
    """Leaves a mode when row . z falls below zero."""

    row: Array
    mode: str  # of the same part
    resets: tuple[tuple[int, Array], ...] = ()  # (state, row): the state becomes row . z


class Part(Protocol):
    """Something with forces and, perhaps, modes; piecewise affine."""

    @property
    def name(self) -> str:
        """Name, unique in a scene."""

    @property
    def modes(self) -> tuple[str, ...]:
        """Names of its modes; it starts in the first."""

    @property
    def has_guards(self) -> bool:
        """False when it has one mode, or changes it by the clock only."""

    def assemble(self, rows: "Rows", mode: str) -> None:
        """Add rates, forces, powers and stored energy of this mode."""

    def constrain(self, rows: "Rows", mode: str) -> None:
        """Called when all forces are known: may stop a body."""

    def guards(self, rows: "Rows", mode: str) -> Sequence[Guard]:
        """Guards of this mode; called last."""


class PlainPart:
    """Defaults of most parts: no constraint on a body, and mode changes by the clock only."""

    has_guards: bool = False

    def constrain(self, rows: "Rows", mode: str) -> None:
        """No-op: no body is constrained."""

    def guards(self, rows: "Rows", mode: str) -> Sequence[Guard]:
        """No guards."""
        return ()


@dataclass(frozen=True)
class LinearPart(PlainPart):
    """A part with a single mode."""

    name: str
    write: Callable[["Rows"], None]
    modes: tuple[str, ...] = ("linear",)

    def assemble(self, rows: "Rows", mode: str) -> None:
        """Add the part's forces in its only mode."""
        self.write(rows)


class _HandPart(Protocol):
    """Interface of the hand to effects."""

    name: str

    def follow(self, scene: "PlantModel", name: str, amplitude: float, omega: float, phase: float) -> None:
        """Add a sinusoid to the voluntary motion of the hand."""

    def add_grasp(self, stiffness: float, damping: float) -> str:
        """Return the mode of a further grasp."""


class TorqueCommand(Protocol):
    """Changes the torque of a hold before it reaches the motor; one without states inherits the defaults.

    Attributes:
        state_names: States of its own.
        passes: Largest torque that it lets through as it is, in both directions [N or N*m]; -1 when it changes or
            remembers any.
    """

    state_names: tuple[str, ...] = ()
    passes: float = -1.0

    def reset(self) -> None:
        """Return to the start; stateless by default."""
        return

    def apply(self, torque: float, duration: float) -> float:
        """Return the torque [N or N*m] that acts during the `duration` [s] to come."""


class _Encoder(Protocol):
    """Changes the position that the encoder reports."""

    def read(self, position: float, tick: int, seed: int) -> float:
        """Return the reading [m or rad] of `position` at `tick`; the same tick always reads the same."""


class NonlinearForce(Protocol):
    """A force on the motor's body that is not piecewise affine: held over a substep, solved together with its motion.

    One without state or stored energy inherits the rest and defines `account` and `force` alone.

    Attributes:
        state_names: States of its own.
        account: Account of its work; None when it is stored.
    """

    state_names: tuple[str, ...] = ()
    account: Account | None

    def reset(self) -> None:
        """Return to the start; stateless by default."""
        return

    def force(self, position: float, travel: float, duration: float, torque: float) -> float:
        """Return the mean force [N or N*m] over a substep that starts at `position` and moves by `travel`."""

    def commit(self, position: float, travel: float, duration: float, torque: float) -> None:
        """Accept the substep; stateless by default."""
        return

    def stored(self, position: float) -> float:
        """Energy stored in it [J]; 0 by default."""
        return 0.0


@dataclass
class PlantModel:
    """Collected parts of a plant, from its parameters, the user and the effects."""

    sample_time: float  # [s]
    states: dict[str, float] = field(default_factory=dict)  # name -> initial value
    bodies: list[Body] = field(default_factory=list)
    parts: list[Part] = field(default_factory=list)
    works: dict[str, Account] = field(default_factory=dict)  # name -> account, booked as integrals of a power
    commands: list[TorqueCommand] = field(default_factory=list)
    encoders: list[_Encoder] = field(default_factory=list)
    efforts: list[NonlinearForce] = field(default_factory=list)
    schedule: list[tuple[float, str, str]] = field(default_factory=list)  # (time [s], part, mode)
    deflection: dict[str, float] = field(default_factory=dict)  # name -> factor: hand's deflection minus position
    slots: dict[str, str] = field(default_factory=dict)  # what may be there once -> the effect that is
    hand: _HandPart | None = None
    shaft: tuple[float, float] | None = None  # stiffness and damping of the shaft
    motor_torque: str = "torque"  # state or input that drives the motor's body

    def add_state(self, name: str, initial: float = 0.0) -> None:
        """Add a state; names are unique in a scene."""
        if name in self.states:
            raise ParameterError(f"state {name!r} twice, expected once; give each effect of one type its own place")
        self.states[name] = initial

    def claim(self, slot: str, effect: str) -> None:
        """Take a place that only one effect may have.

        Raises:
            ParameterError: Another effect has it.
        """
        if slot in self.slots:
            raise ParameterError(f"effects: got {self.slots[slot]} and {effect}, expected one {slot}; remove one")
        self.slots[slot] = effect

    @property
    def names(self) -> tuple[str, ...]:
        """Components of the state vector, in order."""
        extra = ("travel", "effort") if self.efforts else ()
        return (*self.states, *extra, "torque", "one")


class _PlantPart(Protocol):
    """Anything that a scene names: the moving mass, the user, an effect."""

    def add_to(self, scene: PlantModel) -> None:
        """Add its components."""


class _Effect(_PlantPart, Protocol):
    """An effect of the scene."""

    rank: ClassVar[int]

    @property
    def type(self) -> str:
        """Its name in a scene."""


def collect(axis: _PlantPart, user: _PlantPart | None, effects: Sequence[_Effect], sample_time: float) -> PlantModel:
    """The model of a plant: body, shaft and motor first, then the hand, then the other effects.

    Raises:
        ParameterError: An effect needs another that is not there, or two exclude each other.
    """
    scene = PlantModel(sample_time)
    axis.add_to(scene)
    ranked = sorted(effects, key=lambda effect: effect.rank)
    for effect in (effect for effect in ranked if effect.rank == 0):
        _add(effect, scene)
    if user:
        user.add_to(scene)
    for effect in (effect for effect in ranked if effect.rank > 0):
        _add(effect, scene)
    for part in (*scene.commands, *scene.efforts):
        watch(type(part), ("apply", "force"), FORCE)
        watch(type(part), ("stored",))
    return scene


def _add(effect: _Effect, scene: PlantModel) -> None:
    try:
        effect.add_to(scene)
    except ParameterError as error:
        error.part = effect.type
        raise


class Rows:
    """The equations of one mode, written by its parts.

    Attributes:
        rates: F of dz/dt = F z, shape (n, n).
        powers: One S per kind of work, shape (works, n, n) [W].
        storage: P with z'Pz the stored energy, shape (n, n) [J].
        forces: Sum of the forces on each body, one row each.
    """

    def __init__(self, scene: PlantModel) -> None:
        self.scene = scene
        self.index = {name: i for i, name in enumerate(scene.names)}
        self.size = len(self.index)
        self._works = {name: i for i, name in enumerate(scene.works)}
        self.rates = np.zeros((self.size, self.size))
        self.powers = np.zeros((len(scene.works), self.size, self.size))
        self.storage = np.zeros((self.size, self.size))
        self.forces = [np.zeros(self.size) for _ in scene.bodies]

    def row(self, **factors: float) -> Array:
        """Return the row with these factors, by name of the component."""
        row = np.zeros(self.size)
        for name, factor in factors.items():
            row[self.index[name]] = factor
        return row

    def position(self, body: int) -> Array:
        """Return the row of a body's position."""
        return self.row(**dict(self.scene.bodies[body].position))

    def velocity(self, body: int) -> Array:
        """Return the row of a body's velocity."""
        return self.row(**{self.scene.bodies[body].velocity: 1.0})

    def set_rate(self, state: str, row: Array) -> None:
        """Make d(state)/dt = row . z."""
        self.rates[self.index[state]] = row

    def add_power(self, work: str, force: Array, velocity: Array) -> None:
        """Book the power (force . z)(velocity . z) as `work`."""
        product = np.outer(force, velocity)
        self.powers[self._works[work]] += 0.5 * (product + product.T)

    def add_storage(self, coefficient: float, row: Array) -> None:
        """Add the stored energy coefficient / 2 * (row . z)^2."""
        self.storage += 0.5 * coefficient * np.outer(row, row)

    def close(self) -> None:
        """Turn the sums of forces into accelerations; called once, before `constrain`."""
        for body, force in zip(self.scene.bodies, self.forces, strict=True):
            self.set_rate(body.velocity, force / body.mass)
            self.add_storage(body.mass, self.row(**{body.velocity: 1.0}))

    def hold_still(self, body: int) -> None:
        """Stop a body: no acceleration. Its velocity must have been reset to zero."""
        self.set_rate(self.scene.bodies[body].velocity, np.zeros(self.size))
