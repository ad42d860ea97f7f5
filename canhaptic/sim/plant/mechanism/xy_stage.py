"""An X-Y stage: a carriage on a bridge, each moved by its own motor, the handle on the carriage.

The motor axes are the task axes. The masses moved in x and in y may differ; an elliptic hand couples the directions.
The stage is piecewise affine and moved by the same exact automaton as a plant of one axis: with dry friction, breakaway
and sticking are bracketed to T / 2^24. The held forces are states that do not change.
"""

import math
from collections.abc import Sequence
from typing import Annotated, ClassVar, Final

from canhaptic.axis_units import Motion
from canhaptic.signals import PlantEnergy
from canhaptic.sim.plant import LEVELS
from canhaptic.sim.plant.assembly import LEAST_MASS, Body, LinearPart, PlantModel, Rows
from canhaptic.sim.plant.contact import DryFriction
from canhaptic.sim.plant.hybrid_automaton import AutomatonClock, HybridAutomaton
from canhaptic.sim.plant.mechanism.task_hand import Length, PointerTaskHand, TaskHand
from canhaptic.sim.plant.propagator import TICKS
from canhaptic.units import Parameters, quantity

_NAMES: Final = ("x", "y")
_TIDY: Final = TICKS << 10
_MAX_EVENTS: Final = 1000  # in one hold


class XYStage(Parameters):
    """Masses and guides of the stage."""

    motion: ClassVar[Motion] = "m"
    axes: ClassVar[int] = 2
    order: ClassVar[int | None] = None

    mass_x: Annotated[float, quantity("kg", ge=LEAST_MASS, le=1e6)]
    """Mass that moves in x: bridge, carriage and handle."""
    mass_y: Annotated[float, quantity("kg", ge=LEAST_MASS, le=1e6)]
    """Mass that moves in y: carriage and handle."""
    damping_x: Annotated[float, quantity("N*s/m", ge=0.0, le=1e6)] = 0.0
    """Viscous friction of the guide in x."""
    damping_y: Annotated[float, quantity("N*s/m", ge=0.0, le=1e6)] = 0.0
    """Viscous friction of the guide in y."""
    friction_x: DryFriction | None = None
    """Dry friction of the guide in x; None: none."""
    friction_y: DryFriction | None = None
    """Dry friction of the guide in y; None: none."""
    initial_position: tuple[Length, Length] = (0.0, 0.0)
    """Initial position of the stage."""

    def build(self, hand: TaskHand | None, sample_time_ns: int, substeps: int) -> "XYMotion":
        """Return the stage at rest; it needs no substeps."""
        return XYMotion(self, hand, sample_time_ns)


class XYMotion(AutomatonClock):
    """The stage in motion.

    Args:
        stage: Masses and guides of the stage.
        hand: Hand at the handle; None without a hand.
        sample_time_ns: T [ns].

    Attributes:
        state_names: Names of all states.
        force_places: Indices of the motors' forces in the state.
        position_places: Indices of the positions in the state.
        is_linear: Whether a hold is a single linear flow, without dry friction.
    """

    def __init__(self, stage: XYStage, hand: TaskHand | None, sample_time_ns: int) -> None:
        super().__init__(sample_time_ns)
        self._parts = stage, hand, sample_time_ns * 1e-9
        scene = self.model()
        self._machine = machine = HybridAutomaton(scene, _MAX_EVENTS, LEVELS)
        self.is_linear = not any(part.has_guards for part in scene.parts)
        self._run = machine.run_free if self.is_linear else machine.run
        self.state_names = scene.names
        self.position_places, self._velocities, self.force_places = (
            [scene.names.index(f"{name}_{what}") for name in _NAMES] for what in ("position", "velocity", "force")
        )
        self._masses = (stage.mass_x, stage.mass_y)
        self._works = [_works_of(name, scene) for name in _NAMES]

    @property
    def positions(self) -> tuple[float, ...]:
        """True positions in x and y [m]."""
        state = self._machine.state
        return tuple(state.item(i) for i in self.position_places)

    @property
    def velocities(self) -> tuple[float, ...]:
        """True velocities in x and y [m/s]."""
        state = self._machine.state
        return tuple(state.item(i) for i in self._velocities)

    def model(self) -> PlantModel:
        """Equations of the stage and its hand, as the parts of a plant."""
        stage, hand, sample_time = self._parts
        scene = PlantModel(sample_time)
        masses, dampings = (stage.mass_x, stage.mass_y), (stage.damping_x, stage.damping_y)
        for body, name in enumerate(_NAMES):
            scene.add_state(f"{name}_position", stage.initial_position[body])
            scene.add_state(f"{name}_velocity")
            scene.add_state(f"{name}_force")
            scene.bodies.append(Body(name, masses[body], f"{name}_velocity", ((f"{name}_position", 1.0),)))
            _add_axis(scene, body, name, dampings[body])
        for body, friction in enumerate((stage.friction_x, stage.friction_y)):
            if friction is not None:
                friction.add_stick_slip(scene, f"{_NAMES[body]}_friction", body)
        if hand is not None:
            _add_hand(scene, hand)
        return scene

    @property
    def handle(self) -> tuple[float, float]:
        """Position of the handle [m]: on the carriage."""
        x, y = self.positions
        return x, y

    def move_hand(self, x: float, y: float) -> None:
        """Move a `PointerTaskHand` to a position [m] for the following holds; only between two holds.

        Raises:
            ParameterError: The position is not finite.
        """
        self.require_finite("hand position", (x, y))
        self._machine.set_states({"x_hand_place": x, "y_hand_place": y})

    def advance_to(self, now: int, torques: Sequence[float]) -> None:
        """Move to `now` [ns] under forces [N] that were constant since the last call.

        Raises:
            ParameterError: `now` lies before the last call, or a force is not finite.
            EventLimitError: One sample time has more than 1000 events.
        """
        self.require_finite("force", torques)
        before = self.tick
        ticks = self.pass_until(now)
        if ticks:
            machine = self._machine
            for place, force in zip(self.force_places, torques, strict=True):
                machine.state[place] = force
            machine.allow_events(before, before + ticks)
            self._run(ticks)
            if before // _TIDY != self.tick // _TIDY:
                machine.tidy()

    def energy(self, axis: int) -> PlantEnergy:
        """Return the true energies of one direction since the start [J]; each direction has its own mass."""
        works = self._machine.works()
        motor, user, dissipated = (sum(works[i] for i in places) for places in self._works[axis])
        return PlantEnergy(motor, user, dissipated, 0.5 * self._masses[axis] * self.velocities[axis] ** 2)


def _works_of(name: str, scene: PlantModel) -> list[list[int]]:
    """Return the indices of the works in one direction: motor, user and dissipated."""
    works = [(i, account) for i, (work, account) in enumerate(scene.works.items()) if work.startswith(f"{name}_")]
    return [[i for i, of in works if of == account] for account in ("motor", "user", "dissipated")]


def _add_axis(scene: PlantModel, body: int, name: str, damping: float) -> None:
    """Add the motor of a direction and the damping of its guide."""

    def write(rows: Rows) -> None:
        velocity, force = rows.velocity(body), rows.row(**{f"{name}_force": 1.0})
        rows.set_rate(f"{name}_position", velocity)
        rows.forces[body] += force
        rows.add_power(f"{name}_motor", force, velocity)
        if damping:
            rows.forces[body] -= damping * velocity
            rows.add_power(f"{name}_guide", damping * velocity, velocity)

    scene.works[f"{name}_motor"] = "motor"
    if damping:
        scene.works[f"{name}_guide"] = "dissipated"
    scene.parts.append(LinearPart(f"{name}_motor", write))


def _add_hand(scene: PlantModel, hand: TaskHand) -> None:
    omegas = [2.0 * math.pi * motion.frequency if motion else 0.0 for motion in hand.motions]
    for name, motion in zip(_NAMES, hand.motions, strict=True):
        if motion is not None:
            scene.add_state(f"{name}_motion_sine", math.sin(motion.phase))
            scene.add_state(f"{name}_motion_cosine", math.cos(motion.phase))
        scene.works[f"{name}_hand"] = "user"
    is_placed = isinstance(hand, PointerTaskHand)
    if is_placed:
        for name, rest in zip(_NAMES, hand.rest, strict=True):
            scene.add_state(f"{name}_hand_place", rest)
    stiffness, damping = hand.stiffness_matrix, hand.damping_matrix

    def write(rows: Rows) -> None:
        stretch, rate = [], []  # x_u - x and v_u - v, as rows
        for body, (name, motion, omega) in enumerate(zip(_NAMES, hand.motions, omegas, strict=True)):
            offset = hand.rest[body] + (motion.offset if motion else 0.0)
            place = rows.row(**{f"{name}_hand_place": 1.0}) if is_placed else rows.row(one=offset)
            stretch.append(place - rows.position(body))
            rate.append(-rows.velocity(body))
            if motion is not None:
                sine, cosine = f"{name}_motion_sine", f"{name}_motion_cosine"
                rows.set_rate(sine, rows.row(**{cosine: omega}))
                rows.set_rate(cosine, rows.row(**{sine: -omega}))
                stretch[body] = stretch[body] + rows.row(**{sine: motion.amplitude})
                rate[body] = rate[body] + rows.row(**{cosine: motion.amplitude * omega})
        columns = (
            (stiffness.xx, stiffness.xy, damping.xx, damping.xy),
            (stiffness.xy, stiffness.yy, damping.xy, damping.yy),
        )
        for body, (k_x, k_y, d_x, d_y) in enumerate(columns):
            force = k_x * stretch[0] + k_y * stretch[1] + d_x * rate[0] + d_y * rate[1] + rows.row(one=hand.push[body])
            rows.forces[body] += force
            rows.add_power(f"{_NAMES[body]}_hand", force, rows.velocity(body))

    scene.parts.append(LinearPart("hand", write))
