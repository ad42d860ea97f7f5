"""The model of a plant, from its parts, and its compilation into the data of a mode: flows, work forms and guards.

The state is one vector z = [states..., torque, one]: the held torque and the constant 1 are components of it, so that
every force, rate and guard is a row (force = row . z) and every power a quadratic form z'Sz. A model holds only what
its effects added; nothing is switched off at run time. No scene-specific code is generated.

Strict bounds on a guard between the two ends of a step ensure that no dip below zero is missed. A guard is a row c;
along the flow of a mode, dz/dt = F z, its value is g(t) = c z(t). With d = F z(0), the rate of the state at the start
of a step of length h,

    g(t) = g(0) + p(t) d,   p(t) = c * integral of exp(F s) ds from 0 to t,   g''(t) = c F exp(F t) d.

Rows are taken component by component, so that constant components (a held torque, a body at rest) add nothing.

Chord.  E_j bounds |p_j(t) - (t/h) p_j(h)| for all t in [0, h]. Then g(t) >= min(g(0), g(h)) - sum_j E_j |d_j|.
        From h to 2h: with M = |p(h) - p(2h)/2|, both halves of the chord lie within M of the whole one, and the second
        half starts at exp(F h) z(0), hence E(2h) = M + max(E(h), E(h) |exp(F h)|).
Bend.   S_j bounds |(c F (exp(F t) - I))_j| for all t in [0, h]. Then |g''(t) - c F d| <= sum_j S_j |d_j|.
        From h to 2h: S(2h) = max(S(h), |c F (exp(F h) - I)| + S(h) |exp(F h)|).
Start.  At a step h where ||F h|| <= 1/4: X = exp(|F| h) - I is at least |exp(F t) - I| for all t in [0, h], in every
        component, hence E = (|c F| + |c F| X) h^2 / 8 and S = |c F| X.

E and S are upper bounds for every spectrum; they fall as h^2 and as h, so that halving a step decides. They are strict
up to rounding, which is below the part of a guard's largest term that `stepper.py` takes for zero.

They hold at every length, even if h is a million periods of a fast mode: the doublings need only the flow and the
triangle inequality, not the spectrum. So a step may be as long as the hold. A mode at rest does not appear in d and
widens no bound; if it oscillates, the step is halved until the oscillation is small against the guard. E and S of an
undamped mode grow by a factor at every level; they are capped at a finite number that excludes nothing, because
infinity times a rate of 0 would not be a number.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Final, Literal, NamedTuple, Protocol

import numpy as np

from canhaptic.errors import ParameterError
from canhaptic.own_results import FORCE, watch
from canhaptic.sim.plant import LEVELS
from canhaptic.sim.plant.propagator import Array, doublings, dyadic_flows, series, smallest_step, taylor_flow
from canhaptic.units import Parameters

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
    """Condition to leave a mode: row . z falls below zero."""

    row: Array
    mode: str  # of the same part
    resets: tuple[tuple[int, Array], ...] = ()  # (state, row): the state becomes row . z


class Part:
    """A piecewise-affine part of a plant, with forces and possibly modes.

    Attributes:
        name: Name, unique in a scene.
        modes: Names of its modes; it starts in the first.
        has_guards: Whether it has guards; False if it has one mode, or changes its mode at scheduled times only.
    """

    name: str
    modes: tuple[str, ...]
    has_guards: bool = False

    def assemble(self, rows: "Rows", mode: str) -> None:
        """Add rates, forces, powers and stored energy of this mode."""
        raise NotImplementedError

    def constrain(self, rows: "Rows", mode: str) -> None:
        """Hold a body at rest if the part sticks in `mode`; called when all forces are known. By default no effect."""

    def guards(self, rows: "Rows", mode: str) -> Sequence[Guard]:
        """Return the guards of this mode; called last. By default there are none."""
        return ()


@dataclass(frozen=True)
class LinearPart(Part):
    """A part with a single mode."""

    name: str
    write: Callable[["Rows"], None]
    modes: tuple[str, ...] = ("linear",)

    def assemble(self, rows: "Rows", mode: str) -> None:
        """Add the part's forces in its only mode."""
        self.write(rows)


class TorqueCommand(Protocol):
    """An effect on the torque of a hold before it reaches the motor; without state it inherits the defaults.

    Attributes:
        state_names: Names of its states.
        passes: Largest torque that passes unchanged, in both directions [N or N*m]; -1 if every torque may be changed
            or remembered.
    """

    state_names: tuple[str, ...] = ()
    passes: float = -1.0

    def reset(self) -> None:
        """Return to the initial state; nothing by default."""
        return

    def apply(self, torque: float, duration: float) -> float:
        """Return the torque [N or N*m] that acts during the next `duration` [s]."""


class _Encoder(Protocol):
    """An effect on the position that the encoder reports."""

    def read(self, position: float, tick: int, seed: int) -> float:
        """Return the reading [m or rad] of `position` at `tick`; the same tick always reads the same."""


class NonlinearForce(Protocol):
    """A force on the motor's body that is not piecewise affine: held over a substep, solved together with its motion.

    A force without state and stored energy inherits the defaults and defines only `account` and `force`.

    Attributes:
        state_names: Names of its states.
        account: Energy account of its work; None if the work is stored.
    """

    state_names: tuple[str, ...] = ()
    account: Account | None

    def reset(self) -> None:
        """Return to the initial state; nothing by default."""
        return

    def force(self, position: float, travel: float, duration: float, torque: float) -> float:
        """Return the mean force [N or N*m] over a substep that starts at `position` and moves by `travel`."""

    def commit(self, position: float, travel: float, duration: float, torque: float) -> None:
        """Update the state at the end of a substep; nothing by default."""
        return

    def stored(self, position: float) -> float:
        """Energy stored in it [J]; 0 by default."""
        return 0.0


@dataclass
class PlantModel:
    """Parts of a plant, collected from its parameters, the hand and the effects."""

    sample_time: float  # [s]
    states: dict[str, float] = field(default_factory=dict)  # name -> initial value
    bodies: list[Body] = field(default_factory=list)
    parts: list[Part] = field(default_factory=list)
    works: dict[str, Account] = field(default_factory=dict)  # name -> account, booked as integrals of a power
    commands: list[TorqueCommand] = field(default_factory=list)
    encoders: list[_Encoder] = field(default_factory=list)
    efforts: list[NonlinearForce] = field(default_factory=list)
    schedule: list[tuple[float, str, str]] = field(default_factory=list)  # (time [s], part, mode)
    settings: list[tuple[float, dict[str, float]]] = field(default_factory=list)  # (time [s], values of states)
    deflection: dict[str, float] = field(default_factory=dict)  # name -> factor: hand's deflection minus position
    slots: dict[str, str] = field(default_factory=dict)  # what may be there once -> the effect that is
    hand: Any = None  # a `Hand` that transmits a motion
    shaft: tuple[float, float] | None = None  # stiffness and damping of the shaft
    motor_torque: str = "torque"  # state or input that drives the motor's body

    def add_state(self, name: str, initial: float = 0.0) -> None:
        """Add a state; names are unique in a scene."""
        if name in self.states:
            raise ParameterError(f"got state {name!r} twice, expected once; rename one, or list its effect only once")
        self.states[name] = initial

    def claim(self, slot: str, effect: str) -> None:
        """Reserve a role in the plant (slot), such as the encoder, that only one effect may have.

        Raises:
            ParameterError: Another effect has the slot.
        """
        if slot in self.slots:
            raise ParameterError(f"effects: got {self.slots[slot]} and {effect}, expected one {slot}; remove one")
        self.slots[slot] = effect

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the components of the state vector, in order."""
        extra = ("travel", "effort") if self.efforts else ()
        return (*self.states, *extra, "torque", "one")

    def initial_state(self) -> Array:
        """Return the state at the start, with torque 0."""
        state = np.zeros(len(self.names))
        state[: len(self.states)] = list(self.states.values())
        state[-1] = 1.0
        return state

    def first_key(self) -> tuple[str, ...]:
        """Return the initial mode of all parts."""
        return tuple(part.modes[0] for part in self.parts)

    def fastest_swing(self) -> tuple[float, str]:
        """Return the phase [rad] of the fastest oscillation seen by a guard in one sample time, and its mode.

        A damped oscillation counts for its time constant only. The phase indicates the cost of a hold: three to five
        products per radian while it oscillates, and nothing while it is at rest. 0 if no guard sees an oscillation.
        """
        most, where, seen, found = 0.0, "", set(), [self.first_key()]
        while found:
            if (key := found.pop()) in seen:
                continue
            seen.add(key)
            rows, parts = _equations(self, key), list(zip(self.parts, key, strict=True))
            guards = [(i, guard) for i, (part, mode) in enumerate(parts) for guard in part.guards(rows, mode)]
            found += [(*key[:i], guard.mode, *key[i + 1 :]) for i, guard in guards]
            swings = [root for root in np.linalg.eigvals(rows.rates) if guards and root.imag > 0.0]
            phase = max((r.imag / max(1.0 / self.sample_time, abs(r.real)) for r in swings), default=0.0)
            if phase > most:
                most = float(phase)
                where = ", ".join(f"{part.name} {mode}" for part, mode in parts if len(part.modes) > 1)
        return most, where


class EffectParameters(Parameters):
    """Base of the effects; by default an effect is exact and added after the hand. See `Effect`."""

    order: ClassVar[int | None] = None
    rank: ClassVar[int] = 1


def collect(axis: Any, user: Any, effects: Sequence[Any], sample_time: float) -> PlantModel:
    """Return the model of a plant: body, shaft and motor first, then the hand, then the other effects.

    Args:
        axis: Parameters of the moving mass, with `add_to` like the hand and the effects.
        user: The hand; None for a free handle.
        effects: Effects of the scene; see `canhaptic.sim.plant.effects.Effect`.
        sample_time: T [s].

    Raises:
        ParameterError: An effect needs another that is not there, or two exclude each other.
    """
    scene = PlantModel(sample_time)
    axis.add_to(scene)
    parts = (*effects, user) if user else effects
    for part in sorted(parts, key=lambda part: getattr(part, "rank", 0.5)):  # a hand has none
        try:
            part.add_to(scene)
        except ParameterError as error:
            error.part = getattr(part, "type", error.part)
            raise
    for kind in {type(part) for part in (*scene.commands, *scene.efforts)}:
        watch(kind, ("apply", "force"), FORCE)
        watch(kind, ("stored",))
    return scene


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


_LOOSENING: Final = 1.0 + 1e-9
"""Factor on the bounds that covers their own rounding."""
_USELESS: Final = 1e140  # a bound this large excludes nothing; its square is still a number


class GuardBounds(NamedTuple):
    """Bounds of one mode, for steps of T / 2^level; y = `scaled` z are the scaled rates of the state.

    Attributes:
        scaled: Rows of the scaled rates, without those that are always zero, shape (m, n).
        slack: |y| * slack[level, guard] is at least the distance of the guard from its chord; shape (levels + 1, c).
        chord: The same bound, tighter: sum of |y_j| * chord[level, guard, j]; shape (levels + 1, c, m).
        bend: Second derivative of the guard at the start of a step: bend[guard] . y; shape (c, m).
        spread: Bound of its change in the step: sum of |y_j| * spread[level, guard, j]; shape (levels + 1, c, m).
    """

    scaled: Array
    slack: Array
    chord: Array
    bend: Array
    spread: Array


def guard_bounds(guards: Array, rates: Array, sample_time: float) -> GuardBounds:
    """Return the bounds of the guards of one mode.

    Args:
        guards: Rows of the guards, shape (c, n).
        rates: F of dz/dt = F z, shape (n, n).
        sample_time: T [s], the largest step, for which the rates are scaled to equal weight.
    """
    moving = rates.any(axis=1) if len(guards) else np.zeros(len(rates), dtype=bool)
    chord, spread = (_LOOSENING * bound[:, :, moving] for bound in _bounds(guards, rates, sample_time))
    largest = chord[0].max(axis=1, initial=0.0)
    largest[largest == 0.0] = 1.0
    weights = (chord[0] / largest[:, None]).max(axis=0, initial=0.0)
    weights = np.maximum(weights, 1e-3 * weights.max(initial=0.0))  # a rate that matters at finer steps only
    weights[weights == 0.0] = 1.0
    chord, spread, bend = chord / weights, spread / weights, (guards @ rates)[:, moving] / weights
    return GuardBounds(
        weights[:, None] * rates[moving], _LOOSENING * np.linalg.norm(chord, axis=2), chord, bend, spread
    )


def _bounds(guards: Array, rates: Array, sample_time: float) -> tuple[Array, Array]:
    """Return the bounds E and S of the module docstring by level, shapes (levels + 1, c, n)."""
    if not len(guards):
        return np.zeros((LEVELS + 1, 0, len(rates))), np.zeros((LEVELS + 1, 0, len(rates)))
    step, halvings = smallest_step(rates, sample_time)
    slopes, identity = guards @ rates, np.eye(len(rates))
    most = taylor_flow(np.abs(rates), step)
    spread = np.abs(slopes) @ most
    chord = (np.abs(slopes) + spread) * (step * step / 8.0)
    path = step * (guards @ series(identity, lambda term: term @ (rates * step)))  # with the mean of exp(F t) to h
    chords, spreads = [], []
    for level, change in doublings(rates, step, halvings):
        if level <= LEVELS:
            chords.append(chord)
            spreads.append(spread)
        flow, further = np.abs(identity + change), path @ change
        chord = np.minimum(0.5 * np.abs(further) + np.maximum(chord, chord @ flow), _USELESS)
        spread = np.minimum(np.maximum(spread, np.abs(slopes @ change) + spread @ flow), _USELESS)
        path = 2.0 * path + further
    return np.array(chords[::-1]), np.array(spreads[::-1])


_Product = Callable[[Array, Array], object]


class Exit(NamedTuple):
    """The mode that a plant enters when a guard falls below zero, and the jump of its state."""

    part: int
    mode: str
    resets: tuple[tuple[int, Array], ...]
    work: int  # index of the work that takes the energy lost in the resets, -1 when there is none


class Mode(NamedTuple):
    """Flows, works and guards of one mode of a plant, as arrays."""

    key: tuple[str, ...]  # mode of each part
    flows: list[_Product]  # by level: z -> z after T / 2^level
    works: list[_Product]  # by level: z -> for each work [form times shifted z, unit row]; then the shifted z
    forms: Array  # Q of each work over T, of the shifted z, shape (kinds, n, n)
    guards: Array  # values and rates of the guards, and the scaled rates of the state as rows, shape (2 c + m, n)
    bounds: GuardBounds
    exits: list[Exit]
    storage: Array  # P with z'Pz the stored energy


def _equations(scene: PlantModel, key: tuple[str, ...]) -> Rows:
    """Return the equations of the mode in which part i is in `key[i]`."""
    rows = Rows(scene)
    for part, mode in zip(scene.parts, key, strict=True):
        part.assemble(rows, mode)
    rows.close()
    for part, mode in zip(scene.parts, key, strict=True):
        part.constrain(rows, mode)
    return rows


def compile_mode(scene: PlantModel, key: tuple[str, ...]) -> Mode:
    """Compile the mode of a plant in which part i is in its mode `key[i]`."""
    rows = _equations(scene, key)
    names = list(scene.works)
    guards, exits = [], []
    for i, (part, mode) in enumerate(zip(scene.parts, key, strict=True)):
        work = names.index(part.name) if part.name in names else -1
        for guard in part.guards(rows, mode):
            guards.append(guard.row)
            exits.append(Exit(i, guard.mode, guard.resets, work))
    values = np.array(guards).reshape(len(guards), rows.size)
    flows, works, forms = _forms(rows, scene)
    bounds = guard_bounds(values, rows.rates, scene.sample_time)
    guarded = np.concatenate([values, values @ rows.rates, bounds.scaled])
    return Mode(key, flows, works, forms, guarded, bounds, exits, rows.storage)


def _forms(rows: Rows, scene: PlantModel) -> tuple[list[_Product], list[_Product], Array]:
    """Return the flows, and the works as forms of the state with the hand's deflection instead of the position.

    In q and x_u the squares of a stiff hand would cancel: 1e6 N/m at 10 mm is 50 J, against the 0.1 J that flow.
    """
    shift = np.eye(rows.size)
    for name, factor in scene.deflection.items():
        shift[rows.index["position"], rows.index[name]] = factor
    back = 2.0 * np.eye(rows.size) - shift
    flows, _ = dyadic_flows(rows.rates, (), scene.sample_time)
    powers = [back.T @ power @ back for power in rows.powers]
    _, works = dyadic_flows(shift @ rows.rates @ back, powers, scene.sample_time)
    stacked = [matrix.copy().dot for matrix in _stacked(np.array(works), shift)]
    return [flow.dot for flow in flows], stacked, works[0]


def _stacked(forms: Array, shift: Array) -> Array:
    """Return the matrix of `Mode.works` of each level; see `stepper.StepBuffers` for its use.

    Args:
        forms: Q by level and kind of energy, shape (levels, kinds, n, n).
        shift: z -> z with the deflection in the place of the position, shape (n, n).
    """
    levels, kinds, size, _ = forms.shape
    blocks = np.zeros((levels, kinds, size + kinds, size))
    blocks[:, :, :size] = forms @ shift
    for kind in range(kinds):
        blocks[:, kind, size + kind, -1] = 1.0  # times the component one: picks the total of this kind
    last = np.broadcast_to(shift, (levels, size, size))
    return np.concatenate([blocks.reshape(levels, -1, size), last], axis=1)
