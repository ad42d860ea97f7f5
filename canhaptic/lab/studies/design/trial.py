"""Trials of walls, and of the networks of groups, on the simulated rig of a scene.

Walls are tried in one batch of the sweep engine, by two hands:

    lean     a hand without a spring pushes with a constant force: the stiffness at rest
    press    a hand moves into the wall and out again: the energy stored, returned and dissipated

A wall passes if both hands find its stiffness, and the second its damping, within the tolerance, and if no more energy
came out than went in. With a declared device damping b, `guarded` guarantees sum(h_i) + (b / T) sum(dq^2) >= 0; then
this sum is judged, and the energy that the port alone generated is reported. For a scene with real drives the plant is
what `passivity` declares: the least moving mass and damping, on which the certificates rest.

A network is described in a design by one stiffness and one damping, with which all others scale:

surface, path, coupled handles, virtual mass    its own `stiffness` and `damping`
anisotropic spring       the largest eigenvalues of both matrices, whose shapes stay; without a damping matrix the
                         damping has the shape of the stiffness
general                  the springs and forms that the ports move, and the dissipators at the ports or in parallel
                         with a spring; masses, inner springs and nonlinear elements are unchanged. Without such
                         a damper each of those springs gets one in proportion to its stiffness

Networks are tried by the hands of the scene, without a bus:

    lean      the hands rest where the network of the scene pushes most
    stroke    the hands move as in the scene

A network passes if the held torques match its spring within the tolerance (least squares over the holds in contact), if
its damping is rendered within the tolerance in the stroke, and if no more energy came out than went in.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, fields, replace
from typing import Any, Final, NamedTuple, cast

import numpy as np
import yaml
from numpy.typing import NDArray

from canhaptic.control.balance import RANKS, WEAKEST_LAST, Certificate
from canhaptic.control.port_hamiltonian import network as parts
from canhaptic.control.port_hamiltonian.shapes.anisotropic_spring import AnisotropicSpring
from canhaptic.control.port_hamiltonian.shapes.general import General
from canhaptic.control.verdict import PASSIVE_TOLERANCE
from canhaptic.errors import CanHapticError, InputError
from canhaptic.lab.batch import ChosenEngine, Engine, chosen_engine
from canhaptic.lab.batch.cases import why_not_beforehand
from canhaptic.lab.batch.network_loop import network_loop, shares
from canhaptic.lab.batch.scalar import render, run_network
from canhaptic.lab.loop.axis_loop import Array
from canhaptic.lab.studies import Row, chunk
from canhaptic.lab.studies.compare import compare
from canhaptic.lab.studies.design.contact_quality import felt_of
from canhaptic.lab.studies.vary import CONTROLLER, Column, listed, make_points, ranged
from canhaptic.scene.hints import LEAN, guarantee, stability_hints
from canhaptic.scene.load import scene_from_text
from canhaptic.scene.method import simulation_of
from canhaptic.scene.models import AxisScene, MechanismScene, Scene, task_unit
from canhaptic.sim.plant.mechanism.task_hand import PlaneMotion
from canhaptic.sim.plant.user import RecordedMotion, SinusoidMotion
from canhaptic.units import Parameters

_Matrix = Sequence[Sequence[float]]


class NetworkScale(NamedTuple):
    """Stiffness and damping of a network, as a design varies them."""

    stiffness: float  # of the scene [N/m or N*m/rad]
    with_values: Callable[[float, float], Parameters]  # the network with another stiffness and damping


def network_scale(network: Parameters, name: str) -> NetworkScale:
    """Return the stiffness and damping of a network, as a design varies them.

    Args:
        network: Network of a scene.
        name: Name of the network in a scene.

    Raises:
        InputError: The network has no spring at a port.
    """
    if isinstance(network, AnisotropicSpring):
        return _anisotropic(network)
    if isinstance(network, General):
        return _general(network, name)
    if not hasattr(network, "stiffness") or not hasattr(network, "damping"):
        raise InputError(f"network {name!r} has no stiffness to design; expected a network with a spring at its ports")
    return NetworkScale(
        cast(Any, network).stiffness,
        lambda stiffness, damping: network.model_copy(update={"stiffness": stiffness, "damping": damping}),
    )


def _anisotropic(network: AnisotropicSpring) -> NetworkScale:
    stiffest = _largest(network.stiffness)
    if stiffest == 0.0:
        raise InputError("network 'anisotropic_spring' has the stiffness 0 in every direction; give it a shape")
    shape = network.damping if network.damping is not None and _largest(network.damping) else network.stiffness

    def with_values(stiffness: float, damping: float) -> Parameters:
        damped = _times(shape, damping / _largest(shape)) if damping else None
        stiffened = _times(network.stiffness, stiffness / stiffest)
        return network.model_copy(update={"stiffness": stiffened, "damping": damped})

    return NetworkScale(stiffest, with_values)


def _general(network: General, name: str) -> NetworkScale:
    at_ports = _moved_by_ports(network)
    stiffest = max((_size(storage) for storage, _, _ in at_ports.values()), default=0.0)
    if stiffest == 0.0:
        raise InputError(
            f"network {name!r} has no spring at its ports, so no stiffness to design; its masses and inner "
            "springs stay as the scene gives them"
        )
    most = max((_size(part) for part in network.dissipators if _is_outer(part)), default=0.0)
    dissipators = network.dissipators if most else (*network.dissipators, *map(_in_proportion, at_ports.values()))
    most = most or stiffest

    def with_values(stiffness: float, damping: float) -> Parameters:
        storages = tuple(
            _scaled(storage, stiffness / stiffest) if place in at_ports else storage
            for place, storage in enumerate(network.storages)
        )
        damped = tuple(_scaled(part, damping / most) if _is_outer(part) else part for part in dissipators)
        return network.model_copy(update={"storages": storages, "dissipators": damped})

    return NetworkScale(stiffest, with_values)


_AtPort = tuple[parts.Spring | parts.QuadraticForm, int, Array]
"""A storage that a port moves, the index of its first state, and its rows of the gain matrix."""


def _moved_by_ports(network: General) -> dict[int, _AtPort]:
    """Return the springs and forms that a port moves, by their index among the storages."""
    found: dict[int, _AtPort] = {}
    state = 0
    for place, storage in enumerate(network.storages):
        gain = np.array(network.gain[state : state + parts.states_of(storage)])
        if isinstance(storage, parts.Spring | parts.QuadraticForm) and gain.any():
            found[place] = storage, state, gain
        state += parts.states_of(storage)
    return found


def _in_proportion(at_port: _AtPort) -> parts.Dissipator:
    """Return a damper in parallel with a spring that a port moves; its coefficient is the number of the stiffness."""
    storage, state, gain = at_port
    if isinstance(storage, parts.Spring):
        return parts.Damper(type="damper", viscous=storage.stiffness, beside=state)
    matrix = gain.T @ np.array(storage.matrix) @ gain
    return parts.DampingMatrix(
        type="damping_matrix", matrix=_times(matrix.tolist(), 1.0), ports=tuple(range(gain.shape[1]))
    )


def _is_outer(part: parts.Dissipator) -> bool:
    """Whether a dissipator is at the ports or in parallel with a spring."""
    return bool(part.ports) if isinstance(part, parts.DampingMatrix) else not part.states


def _size(part: Parameters) -> float:
    """Return the stiffness or the linear coefficient of a part; for a matrix, its largest eigenvalue."""
    matrix = getattr(part, "matrix", None)
    return float(getattr(part, _coefficient(part))) if matrix is None else _largest(matrix)


def _coefficient(part: Parameters) -> str:
    return "stiffness" if isinstance(part, parts.Spring) else "viscous"


def _scaled(part: Parameters, factor: float) -> Parameters:
    matrix, name = getattr(part, "matrix", None), _coefficient(part)
    if matrix is None:
        return part.model_copy(update={name: getattr(part, name) * factor})
    return part.model_copy(update={"matrix": _times(matrix, factor)})


def _largest(matrix: _Matrix) -> float:
    """Return the largest eigenvalue of a symmetric matrix that is positive semidefinite."""
    return max(0.0, float(np.linalg.eigvalsh(np.array(matrix))[-1]))


def _times(matrix: _Matrix, factor: float) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(factor * value for value in row) for row in matrix)


STIFFNESS, DAMPING = "environment.stiffness", "environment.damping"
_USER: Final = "simulation.user"
ALGORITHM: Final = "guarded"
STIFFEST: Final = 1e8
"""Largest stiffness that a scene may ask for [N/m or N*m/rad]."""
_MOST_DAMPING: Final = 1e6  # [N*s/m or N*m*s/rad]
_HAND: Final = {"stiffness": 300.0, "damping": 3.0}
"""Hand for a scene without a hand: an ordinary grip."""
_DEEPEST: Final = 0.1
"""Depth [m or rad] to which the hand leans into the softest wall that is tried."""
DURATION: Final = 3.0
"""Duration of a trial [s]. A wall too stiff for its certificates softens under a push for some 2 s, until at rest."""
_SLACK: Final = 0.05
"""Amount by which a wall may miss the tolerance without excluding larger walls: the phase of counts and holds makes
the shares of neighbouring walls differ by some tenths of a per cent."""
_DEVICE: Final = ("moving_mass", "device_damping", "device_damping_bound", "device_friction", "device_friction_bound")
"""Keys of the loop that declare the device; keys of the timing belong to the rig."""
_FREQUENCY: Final = 1.0  # of the hand that presses [Hz]
_METRICS: Final = (
    "diverged",
    "least_interaction",
    "least_covered",
    "stiffness_rendered.share",
    "stiffness_at_end.share",
    "damping_rendered.share",
    "contact",
)

Booleans = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class TrialVerdict:
    """Verdicts on many walls, each the worse of both hands; arrays of shape (n,)."""

    stiffness_share: Array  # rendered over asked
    damping_share: Array  # NaN where no damping is asked
    least_interaction: Array  # true, eq. 3 [J]
    least_judged: Array  # that, with what declared damping of the device dissipates at least where it is declared [J]
    passed: Booleans
    nearly: Booleans  # whether it passes with the tolerance wider by `_SLACK`

    def last(self) -> "TrialVerdict":
        """Return the verdict on the last wall only."""
        return TrialVerdict(*(getattr(self, field.name)[-1:] for field in fields(self)))

    def account(self, damping: float) -> dict[str, float | None]:
        """Return the account of the first wall, as in the result of a design.

        Args:
            damping: Damping of the wall; 0: the rendered share of the damping is None.
        """
        return {
            "stiffness_rendered": float(self.stiffness_share[0]),
            "damping_rendered": float(self.damping_share[0]) if damping else None,
            "least_interaction": float(self.least_interaction[0]),
            "least_judged": float(self.least_judged[0]),
        }


class Trials:
    """What walls of an axis and networks of a group have in common; the tries of both hands become a verdict.

    Args:
        scene: Scene with one port, whose algorithm may generate its `energy_allowance`.
        tolerance: Largest relative difference of a rendering from the requested one.

    Attributes:
        remark: Note on the properties taken from the simulated plant.
        remedy: What else helps where nothing passes, after the usual.
        is_costly: Whether Python takes several times as long for a trial as for one of an axis.
        is_quick: Whether trials are computed by compiled code.
        executor: Executor for trials that are not; None: this thread.
        walls: Number of walls or networks tried.

    Raises:
        InputError: The scene has several ports.
    """

    remark = remedy = ""
    is_costly = False
    is_quick: bool
    executor: Executor | None = None

    def __init__(self, scene: Scene, tolerance: float) -> None:
        if len(scene.ports) != 1:
            names = ", ".join(port.name for port in scene.ports)
            raise InputError(f"{scene.source}: has the axes or groups {names}; design takes one: make a scene of each")
        self._tolerance, self.walls = tolerance, 0
        given = scene.ports[0].passivity.parameters
        self._allowance = float(getattr(given, "energy_allowance", 0.0)) + PASSIVE_TOLERANCE

    def _verdict(
        self, shares: Array, damped: Array, least: Array, judged: Array, ran: Any, damping: Array
    ) -> TrialVerdict:
        """Return the verdict on each wall, from the figures under both hands.

        Args:
            shares: Rendered over requested stiffness, shape (2, n).
            damped: Rendered over requested damping, shape (n,).
            least: Least true energy received, shape (2, n) [J].
            judged: Energy that is judged, shape (2, n) [J]: `least`, or the sum that a declared device damping
                guarantees.
            ran: Whether the run was completed, in contact, shape (2, n).
            damping: Requested damping, shape (n,).
        """
        share, worst = _furthest(*shares), judged.min(axis=0)
        passive = ran.all(axis=0) & (worst >= -self._allowance)
        error = np.maximum(np.abs(share - 1.0), np.where(damping > 0.0, np.abs(damped - 1.0), 0.0))
        within = [passive & (error <= limit) for limit in (self._tolerance, self._tolerance * (1.0 + _SLACK))]
        return TrialVerdict(share, damped, least.min(axis=0), worst, *within)


class Trial(Trials):
    """Rig for trials of walls.

    Args:
        scene: Scene with a simulation, or with the certain properties of its drives declared under `passivity`.
        tolerance: Largest relative difference of a rendering from the requested one.
        engine: Engine of the trials, as for a sweep.

    Attributes:
        scene: Scene with the hand leaning on the wall, used for the figures shown.
        hand: Stiffness and damping of the grip [N/m, N*s/m or N*m/rad, N*m*s/rad].
        unit: Unit of the axis's motion.
        softest: Softest wall to try [N/m or N*m/rad].
        engine: Engine that computes the trials.

    Raises:
        InputError: The scene has several axes, or its moving mass is unknown.
    """

    def __init__(self, scene: Scene, tolerance: float, engine: Engine = "auto") -> None:
        super().__init__(scene, tolerance)
        [axis] = scene.axes
        force = LEAN * axis.parameters.torque_limit
        self.unit, self.softest = axis.parameters.unit, force / _DEEPEST
        self._judged = "least_covered" if axis.loop.device_damping else "least_interaction"
        hand = self.hand = _hand(axis)
        travel = 2.0 * force / hand["stiffness"]
        motion = {"amplitude": travel, "frequency": _FREQUENCY, "phase": math.pi / 2.0}
        self.scene = _with_user(scene, {"damping": hand["damping"], "push": -force})
        leans = {"stiffness": 0.0, "motion.amplitude": 0.0, "push": -force}
        presses = {"stiffness": hand["stiffness"], "motion.amplitude": travel, "push": 0.0}
        self._hands = {f"{_USER}.{name}": (leans[name], presses[name]) for name in leans}
        pressed = _with_user(scene, {**hand, "push": 0.0, "motion": motion})
        chosen = chosen_engine(engine, pays=True)
        self.is_quick = chosen == "numba" and not why_not_beforehand(pressed)
        self._recipe = _recipe(pressed, self._hands, chosen)
        self.engine = ""

    def verdict(self, stiffness: Array, damping: Array) -> TrialVerdict:
        """Run both hands against each wall, and judge the walls.

        Args:
            stiffness: Stiffness of each wall, shape (n,) [N/m or N*m/rad].
            damping: Damping of each wall, shape (n,) [N*s/m or N*m*s/rad].

        Raises:
            InputError: Every wall is refused.
        """
        count, name = len(stiffness), self.scene.axes[0].parameters.name
        columns: dict[str, Column] = {
            CONTROLLER: [ALGORITHM] * (2 * count),
            STIFFNESS: np.tile(stiffness, 2),
            DAMPING: np.tile(damping, 2),
            **{key: np.repeat(values, count) for key, values in self._hands.items()},
        }
        self.walls += count
        result = chunk.run_chunk(self._recipe, 0, columns)
        if (result.status == chunk.REFUSED).all():
            raise InputError(f"{self.scene.source}: no wall can be tried: {result.remark[0]}")
        self.engine, self.remark = chunk.ENGINES[int(result.engine.max())], result.of_plant or self.remark
        figures = {metric: result.figures[f"{name}/{metric}"].reshape(2, count) for metric in _METRICS}
        damped = figures["damping_rendered.share"][1]
        ran = (
            (result.status == chunk.COMPLETED).reshape(2, count)
            & (figures["diverged"] == 0.0)
            & (figures["contact"] > 0.0)
        )
        shares = np.stack([figures["stiffness_at_end.share"][0], figures["stiffness_rendered.share"][1]])
        return self._verdict(shares, damped, figures["least_interaction"], figures[self._judged], ran, damping)

    def damping_scale(self, stiffness: float) -> float:
        """Return the larger of m / T, which stops the mass in one hold, and half the critical damping, as a scale."""
        [axis] = self.scene.axes
        mass = simulation_of(axis).plant.mass
        return max(mass / self.scene.bus.sample_time, math.sqrt(stiffness * mass))

    def account(self, verdict: TrialVerdict, stiffness: float, damping: float) -> Row:
        """Return the figures of a wall: its verdict, and that of a run with the leaning hand."""
        scene, values = self.scene, {STIFFNESS: stiffness, DAMPING: damping}
        places = chunk.places_of(scene, tuple(values))
        overrides = [f"{place}={value!r}" for key, value in values.items() for place in places[key]]
        allowed = bool(scene.own_code)
        wall = scene_from_text(scene.text, scene.source, [*scene.overrides, *overrides], allow_code=allowed)
        [axis] = wall.axes
        [run] = compare(wall, [ALGORITHM], duration=DURATION, repeats=0).result["rows"]
        hints, parameters = stability_hints(axis), axis.passivity.parameters
        return {
            "scene": scene.source,
            "unit": axis.parameters.unit,
            "stiffness": stiffness,
            "damping": damping,
            **verdict.account(damping),
            "certificate": run.get("certificate"),
            "certified": {hint.certificate: hint.limit for hint in hints if hint.certificate},
            "guarantee": [guarantee(axis, hints), *(f"{h.what}: {h.text}" for h in hints if h.is_of_encoder)],
            "engine": self.engine,
            "remark": self.remark,
            "loop": {key: value for key, value in _chosen(axis.loop).items() if key in _DEVICE},
            "hand": {"hand_force": getattr(parameters, "hand_force", 0.0), **_chosen(parameters)},
            "felt": felt_of(scene, ALGORITHM, self.hand, self._tolerance, stiffness),
        }


def _chosen(parameters: Parameters) -> Row:
    """Return the values that differ from their defaults, without `alpha`, which has its own unit."""
    fields = type(parameters).model_fields.items()
    return {k: value for k, of in fields if (value := getattr(parameters, k)) != of.default and k != "alpha"}


def _furthest(first: Array, second: Array) -> Array:
    """Return the share that is furthest from 1; NaN if one is NaN."""
    return np.asarray(np.where(np.abs(first - 1.0) >= np.abs(second - 1.0), first, second) + 0.0 * (first + second))


def _hand(axis: AxisScene) -> dict[str, float]:
    user = axis.simulation.user if axis.simulation is not None else None
    if user is None or not user.stiffness:
        return dict(_HAND)
    return {"stiffness": user.stiffness, "damping": user.damping or _HAND["damping"]}


def _with_user(scene: Scene, user: dict[str, object]) -> Scene:
    """Return the scene with a wall at the origin, the handle in front of it, and another hand."""
    [axis] = scene.axes
    overrides = [*scene.overrides]
    plant, simulation = "simulation.plant", axis.simulation
    if simulation is None:
        overrides.append(f"{plant}={yaml.safe_dump(_declared(axis, scene), default_flow_style=True).strip()}")
    places = chunk.places_of(scene, (f"{plant}.initial_position", "simulation.user", "environment.type"))
    wall = "{type: spring_damper_wall, stiffness: 1, damping: 0}"
    overrides += [f"{place.removesuffix('.type')}={wall}" for place in places["environment.type"]]
    given = yaml.safe_dump(user, default_flow_style=True, width=1000).strip()
    overrides += [f"{place}={given}" for place in places["simulation.user"]]
    overrides += [f"{place}=0.002" for place in places[f"{plant}.initial_position"]]
    return scene_from_text(scene.text, scene.source, overrides, allow_code=bool(scene.own_code))


def _declared(axis: AxisScene, scene: Scene) -> dict[str, float]:
    """Return the plant that the scene declares.

    Raises:
        InputError: The scene neither simulates a plant nor declares a moving mass.
    """
    if axis.loop.moving_mass is None:
        raise InputError(
            f"{scene.source}: neither simulates a plant nor declares passivity.moving_mass; weigh what moves with the "
            "encoder and give a lower bound"
        )
    return {"mass": axis.loop.moving_mass, "damping": axis.loop.device_damping or 0.0}


def _recipe(scene: Scene, hands: Mapping[str, tuple[float, float]], engine: ChosenEngine) -> chunk.Recipe:
    varied = [ranged(STIFFNESS, 1e-3, STIFFEST, 2, "log"), ranged(DAMPING, 0.0, _MOST_DAMPING, 2)]
    points = make_points([*varied, *(listed(key, values) for key, values in hands.items())], [ALGORITHM])
    return chunk.make_recipe(scene, points, metrics=_METRICS, engine=engine, duration=DURATION)


_SPAN: Final = 10.0
"""Ratio of the scene's stiffness to the smallest one that is tried."""
_TIME: Final = 0.05
"""Ratio of damping to stiffness near the limit of rendering [s]."""
_LEAN: Final = 1.0  # [s]
_STROKE: Final = (1.0, 5.0)
"""Shortest and longest time in which the hands move [s]."""
_DECLARED: Final = ("moving_mass", "device_damping", "device_damping_bound")


class _Tried(NamedTuple):
    """Result of one loop."""

    spring: float  # share
    damper: float
    least: float  # [J]
    covered: float
    passed: bool  # whether it ran to its end, in contact
    certificate: int  # its place in `WEAKEST_LAST`


class NetworkTrial(Trials):
    """Rig for trials of networks.

    Args:
        scene: Simulated scene with one group; its network has a spring at its ports (`network_scale`).
        tolerance: Largest relative difference of a rendering from the requested one.
        engine: Engine of the trials.

    Attributes:
        scene: Scene with the hands in motion.
        unit: Unit of the handle's motion.
        softest: Smallest stiffness to try [N/m or N*m/rad].
        engine: Engine that computes the trials.

    Raises:
        InputError: The scene has several ports, a network without a spring at its ports, or motors that
            are not simulated.
    """

    remedy = ", or a smaller passivity.max_consecutive_losses"
    is_costly = True

    def __init__(self, scene: Scene, tolerance: float, engine: Engine = "auto") -> None:
        super().__init__(scene, tolerance)
        [port] = scene.ports
        self._scale = network_scale(port.rendered.parameters, port.rendered.name)
        self.scene = scene
        self.unit = task_unit(port.kinematics.name, port.axes[0].parameters.unit)
        self.softest = min(self._scale.stiffness, STIFFEST) / _SPAN
        self._stroke = _stroke_time(scene)
        self._leaning = self._with_hands_at_rest()
        self._chosen: ChosenEngine = chosen_engine(engine, pays=True)
        self.is_quick = self._chosen == "numba" and not network_loop(scene).why_not
        self.engine = "numba" if self.is_quick else "python"
        self._has_damping = all(axis.loop.device_damping for axis in scene.axes)

    def damping_scale(self, stiffness: float) -> float:
        """Return the damping of a network near the limit of rendering."""
        return _TIME * stiffness

    def verdict(self, stiffness: Array, damping: Array) -> TrialVerdict:
        """Simulate each hand on each port-Hamiltonian environment, and judge the environments; see `Trial.verdict`."""
        self.walls += len(stiffness)
        pairs = list(zip(stiffness.tolist(), damping.tolist(), strict=True))
        jobs = [
            (self._with_network(scene, *pair), time, self._chosen) for scene, time in self._hands() for pair in pairs
        ]
        run: Callable[..., Any] = map if self.executor is None or self.is_quick else self.executor.map
        table = np.array([*run(_tried, jobs)], dtype=float).reshape(2, len(pairs), -1)
        spring, damper, least, covered, ran, _ = np.moveaxis(table, 2, 0)
        judged = covered if self._has_damping else least
        return self._verdict(spring, np.where(damping > 0.0, damper[1], np.nan), least, judged, ran, damping)

    def account(self, verdict: TrialVerdict, stiffness: float, damping: float) -> Row:
        """Return the result of a design for a network: description, verdict and certificate."""
        [port] = self.scene.ports
        loop, given = port.axes[0].loop, port.passivity.parameters
        runs = [_tried((self._with_network(of, stiffness, damping), time, "python")) for of, time in self._hands()]
        network = self._scale.with_values(stiffness, damping).model_dump(mode="json", exclude_unset=True)
        losses = getattr(given, "max_consecutive_losses", 0)
        return {
            "scene": self.scene.source,
            "group": port.name,
            "unit": self.unit,
            "network": {"type": port.rendered.name, **network},
            "stiffness": stiffness,
            "damping": damping,
            **verdict.account(damping),
            "certificate": WEAKEST_LAST[max(run.certificate for run in runs)].name.lower(),
            "certified": {},
            "engine": self.engine,
            "remark": self.remark,
            "loop": {key: value for key in _DECLARED if (value := getattr(loop, key)) is not None},
            "hand": {"hand_force": getattr(given, "hand_force", 0.0)}
            | ({"max_consecutive_losses": losses} if losses else {}),
        }

    def _hands(self) -> Sequence[tuple[Scene, float]]:
        return (self._leaning, _LEAN), (self.scene, self._stroke)

    def _with_network(self, scene: Scene, stiffness: float, damping: float) -> Scene:
        [port] = scene.ports
        network = port.rendered._replace(parameters=self._scale.with_values(stiffness, damping))
        return scene.with_port(port._replace(rendered=network))

    def _with_hands_at_rest(self) -> Scene:
        """Return the scene with its hands at rest where the torques were largest during their motion."""
        period = self.scene.bus.sample_time
        run = render(self.scene, round(self._stroke / period))
        time = int(np.abs(run.torque).max(axis=1).argmax()) * period
        axes = tuple(_at_rest(axis, time) for axis in self.scene.axes)
        mechanisms = tuple(_handle_at_rest(of, time) for of in self.scene.mechanisms)
        return replace(self.scene, axes=axes, mechanisms=mechanisms)


def _tried(job: tuple[Scene, float, ChosenEngine]) -> _Tried:
    scene, time, engine = job
    try:
        meter = run_network(network_loop(scene, explains=True), round(time / scene.bus.sample_time), engine)
    except CanHapticError:
        return _Tried(np.nan, np.nan, 0.0, 0.0, False, RANKS[Certificate.NONE])
    figures = meter.figures
    passed = figures.diverged == 0.0 and figures.contacts > 0.0
    return _Tried(
        *shares(meter), figures.least_interaction, figures.least_covered, passed, round(figures.certificate)
    )  # fmt: skip


def _motions(scene: Scene) -> list[SinusoidMotion | RecordedMotion]:
    users = [axis.simulation.user for axis in scene.axes if axis.simulation is not None]
    hands = [motion for of in scene.mechanisms if of.hand is not None for motion in of.hand.motions]
    found = [*(user.motion for user in users if user is not None), *hands]
    return [motion for motion in found if motion is not None]


def _stroke_time(scene: Scene) -> float:
    slowest = min((motion.frequency for motion in _motions(scene)), default=1.0)
    return min(max(1.0 / slowest, _STROKE[0]), _STROKE[1])


def _at_rest(axis: AxisScene, time: float) -> AxisScene:
    user = axis.simulation.user if axis.simulation is not None else None
    if axis.simulation is None or user is None or user.motion is None:
        return axis
    still = user.model_copy(update={"rest": user.rest + user.motion.position(time), "motion": None})
    return replace(axis, simulation=replace(axis.simulation, user=still))


def _handle_at_rest(of: MechanismScene, time: float) -> MechanismScene:
    if of.hand is None:
        return of
    moved = [0.0 if motion is None else motion.position(time) for motion in of.hand.motions]
    rest = tuple(at + by for at, by in zip(of.hand.rest, moved, strict=True))
    return replace(of, hand=of.hand.model_copy(update={"rest": rest, "motion": PlaneMotion()}))
