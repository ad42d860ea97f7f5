"""Walls on trial: each one leant on and pressed in and out on the simulated rig, all in one batch of the sweep engine.

    lean     a hand without a spring pushes with a constant force: what the wall holds at rest
    press    a hand goes in and out of the wall: what it stores, gives back and dissipates

A wall passes if both hands find its stiffness, and the second its damping, within the tolerance, and if no more energy
came out than went in. Certain damping b of the device, where it is declared, covers energy of the port: `guarded` then
promises sum(h_i) + (b / T) sum(dq^2) >= 0 by proof, which is judged, and what the port alone gave out is reported.

The rig is that of the scene. Where the scene is of real drives its plant is what `passivity` declares: the least moving
mass and damping, which is what the certificates rest on.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Final

import numpy as np
import yaml
from numpy.typing import NDArray

from canhaptic.control.verdict import PASSIVE_TOLERANCE
from canhaptic.errors import InputError
from canhaptic.lab.batch.cases import why_not_beforehand
from canhaptic.lab.batch.engine import ChosenEngine, Engine, chosen_engine
from canhaptic.lab.loop.axis_loop import Array
from canhaptic.lab.studies.sweep.chunk import COMPLETED, ENGINES, REFUSED, ChunkResult, run_chunk
from canhaptic.lab.studies.sweep.places import places_of
from canhaptic.lab.studies.sweep.points import CONTROLLER, Column, make_points
from canhaptic.lab.studies.sweep.recipe import Recipe, make_recipe
from canhaptic.lab.studies.sweep.vary import listed, ranged
from canhaptic.scene.hints import LEAN
from canhaptic.scene.load import scene_from_text
from canhaptic.scene.models import AxisScene, Scene
from canhaptic.scene.torque_history import simulation_of

STIFFNESS, DAMPING = "environment.stiffness", "environment.damping"
_USER: Final = "simulation.user"
ALGORITHM: Final = "guarded"
STIFFEST: Final = 1e8
"""Largest stiffness that a scene may ask for [N/m or N*m/rad]."""
_MOST_DAMPING: Final = 1e6  # [N*s/m or N*m*s/rad]
_HAND: Final = {"stiffness": 300.0, "damping": 3.0}
"""Hand of a scene without one: an ordinary grip."""
_DEEPEST: Final = 0.1
"""Depth [m or rad] to which the hand leans into the softest wall that is tried."""
DURATION: Final = 2.0  # [s]
_SLACK: Final = 0.05
"""Part by which a wall may miss the tolerance and yet not exclude a larger one: where counts and holds happen to
fall makes the shares of neighbours differ by some tenths of a per cent."""
_FREQUENCY: Final = 1.0  # of the hand that presses [Hz]
_METRICS: Final = (
    "diverged",
    "least_interaction",
    "least_covered",
    "stiffness_rendered.share",
    "damping_rendered.mean",
    "contact",
)

Booleans = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class TrialVerdict:
    """Verdicts on many walls, the worse of both hands; each of shape (n,)."""

    stiffness_share: Array  # rendered over asked
    damping_share: Array  # NaN where no damping is asked
    least_interaction: Array  # true, eq. 3 [J]
    least_judged: Array  # that, with what declared damping of the device dissipates at least where it is declared [J]
    passed: Booleans
    nearly: Booleans  # whether it passes with the tolerance wider by `_SLACK`

    def last(self) -> "TrialVerdict":
        """Return that of the last wall alone."""
        return TrialVerdict(*(getattr(self, field.name)[-1:] for field in fields(self)))

    def account(self, damping: float) -> dict[str, float | None]:
        """Return what the first wall rendered and gave out, as in the result of a design.

        Args:
            damping: Damping of the wall; 0: its share is None.
        """
        return {
            "stiffness_rendered": float(self.stiffness_share[0]),
            "damping_rendered": float(self.damping_share[0]) if damping else None,
            "least_interaction": float(self.least_interaction[0]),
            "least_judged": float(self.least_judged[0]),
        }


class Trial:
    """The rig on which walls are tried.

    Args:
        scene: With a simulation, or with what its drives certainly are declared under `passivity`.
        tolerance: How far a rendering may be from what is asked, as a part of it.
        engine: Engine of the trials, as for a sweep.

    Attributes:
        scene: Leaning on the wall; what is shown of a wall is shown of it.
        hand: Stiffness and damping of the grip [N/m, N*s/m or N*m/rad, N*m*s/rad].
        unit: In which the axis moves.
        softest: Wall that is tried [N/m or N*m/rad].
        engine: What computes the trials.
        is_quick: Whether walls are tried compiled.
        walls: How many were tried.

    Raises:
        InputError: Several axes, or nothing known of the moving mass.
    """

    def __init__(self, scene: Scene, tolerance: float, engine: Engine = "auto") -> None:
        if len(scene.axes) != 1:
            names = ", ".join(axis.parameters.name for axis in scene.axes)
            raise InputError(f"{scene.source}: has the axes {names}; a wall is designed for one, make a scene of each")
        [axis] = scene.axes
        self._tolerance = tolerance
        force = LEAN * axis.parameters.torque_limit
        self.unit, self.softest = axis.parameters.unit, force / _DEEPEST
        self._allowance = float(getattr(axis.passivity.parameters, "energy_allowance", 0.0)) + PASSIVE_TOLERANCE
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
        self.engine, self.walls, self.remark = "", 0, ""

    def verdict(self, stiffness: Array, damping: Array) -> TrialVerdict:
        """Try walls.

        Args:
            stiffness: Stiffness of each wall, shape (n,) [N/m or N*m/rad].
            damping: Damping of each wall, shape (n,) [N*s/m or N*m*s/rad].
        """
        count, name = len(stiffness), self.scene.axes[0].parameters.name
        columns: dict[str, Column] = {
            CONTROLLER: [ALGORITHM] * (2 * count),
            STIFFNESS: np.tile(stiffness, 2),
            DAMPING: np.tile(damping, 2),
            **{key: np.repeat(values, count) for key, values in self._hands.items()},
        }
        self.walls += count
        result = run_chunk(self._recipe, 0, columns)
        self._look_at(result)
        figures = {metric: result.figures[f"{name}/{metric}"].reshape(2, count) for metric in _METRICS}
        with np.errstate(all="ignore"):
            damped = np.array(figures["damping_rendered.mean"][1] / np.where(damping > 0.0, damping, np.nan))
        least, judged = (figures[metric].min(axis=0) for metric in ("least_interaction", self._judged))
        ran = (result.status == COMPLETED).reshape(2, count) & (figures["diverged"] == 0.0) & (figures["contact"] > 0.0)
        shares = figures["stiffness_rendered.share"]
        return verdict_of(
            shares, damped, least, judged, ran.all(axis=0), self._allowance, self._tolerance, damping
        )  # fmt: skip

    def damping_scale(self, stiffness: float) -> float:
        """Return a damping that is hardly rendered: it stops the mass in one hold, or is half the critical one."""
        [axis] = self.scene.axes
        mass = simulation_of(axis).plant.mass
        return max(mass / self.scene.bus.sample_time, math.sqrt(stiffness * mass))

    def _look_at(self, result: ChunkResult) -> None:
        """Note what computed the trials, and refuse a rig on which none can be made.

        Raises:
            InputError: Every wall is refused.
        """
        if (result.status == REFUSED).all():
            raise InputError(f"{self.scene.source}: no wall can be tried: {result.texts[0]}")
        self.engine = ENGINES[int(result.engine.max())]
        self.remark = result.of_plant or self.remark


def verdict_of(
    shares: Array, damped: Array, least: Array, judged: Array, ran: Any, allowance: float, tolerance: float,
    damping: Array,
) -> TrialVerdict:  # fmt: skip
    """Return what walls did under two hands.

    Args:
        shares: Stiffness rendered over asked, shape (2, n).
        damped: The same of the damping, shape (n,).
        least: Least true energy that came in, shape (n,) [J].
        judged: What of it is judged [J].
        ran: Whether both hands ran to their end, in contact.
        allowance: Energy that may be given out [J].
        tolerance: How far a rendering may be from what is asked, as a part of it.
        damping: Asked for.
    """
    share, passive = _furthest(*shares), ran & (judged >= -allowance)
    error = np.maximum(np.abs(share - 1.0), np.where(damping > 0.0, np.abs(damped - 1.0), 0.0))
    within = [passive & (error <= limit) for limit in (tolerance, tolerance * (1.0 + _SLACK))]
    return TrialVerdict(share, damped, least, judged, *within)


def _furthest(first: Array, second: Array) -> Array:
    """Return the share furthest from one; NaN stays."""
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
    places = places_of(scene, (f"{plant}.initial_position", "simulation.user", "environment.type"))
    wall = "{type: spring_damper_wall, stiffness: 1, damping: 0}"
    overrides += [f"{place.removesuffix('.type')}={wall}" for place in places["environment.type"]]
    given = yaml.safe_dump(user, default_flow_style=True, width=1000).strip()
    overrides += [f"{place}={given}" for place in places["simulation.user"]]
    overrides += [f"{place}=0.002" for place in places[f"{plant}.initial_position"]]
    return scene_from_text(scene.text, scene.source, overrides, allow_code=bool(scene.own_code))


def _declared(axis: AxisScene, scene: Scene) -> dict[str, float]:
    """Return the plant that the scene declares.

    Raises:
        InputError: It does not say what moves.
    """
    if axis.loop.moving_mass is None:
        raise InputError(
            f"{scene.source}: neither simulates a plant nor declares passivity.moving_mass; weigh what moves with the "
            "encoder and give an under-estimate"
        )
    return {"mass": axis.loop.moving_mass, "damping": axis.loop.device_damping or 0.0}


def _recipe(scene: Scene, hands: Mapping[str, tuple[float, float]], engine: ChosenEngine) -> Recipe:
    varied = [ranged(STIFFNESS, 1e-3, STIFFEST, 2, "log"), ranged(DAMPING, 0.0, _MOST_DAMPING, 2)]
    points = make_points([*varied, *(listed(key, values) for key, values in hands.items())], [ALGORITHM])
    return make_recipe(scene, points, metrics=_METRICS, engine=engine, duration=DURATION)
