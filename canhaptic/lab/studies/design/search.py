"""The largest stiffness, and then the largest damping, that `guarded` renders within a tolerance and with a margin.

A first batch samples the whole range, a second batch the interval in which walls cease to pass. A wall counts only if
every smaller wall that was tried passes or nearly passes, softer walls with the same damping included, because the
rendered share need not fall monotonically.

Of an admittance display it is the lightest virtual mass, for its hand and for similar hands. A mass passes if every
hand feels it within the tolerance and the display generates at most the declared energy. Masses up to 1.1 times
`never_acts` are tried, from heavy to light; the answer is the last before one that fails, times 1 + margin.
"""

import math
import os
from collections.abc import Callable
from dataclasses import replace
from typing import Final, NamedTuple, cast

import numpy as np
import yaml
from rich.console import Group, RenderableType
from rich.text import Text

from canhaptic.axis_units import mass_unit, si, stiffness_unit
from canhaptic.control.admittance.admittance_environment import AdmittanceMass
from canhaptic.control.admittance.group_environment import GroupMass, PathMass
from canhaptic.control.admittance.velocity_loop import GuardedAdmittanceParameters
from canhaptic.control.verdict import PASSIVE_TOLERANCE
from canhaptic.errors import CheckFailedError, InputError
from canhaptic.files import scene_title
from canhaptic.lab.batch import Engine
from canhaptic.lab.batch.scalar import run_scalar
from canhaptic.lab.loop.axis_loop import Array, is_display, parts_of, require_design_room
from canhaptic.lab.studies import Row
from canhaptic.lab.studies.design import trial as trials
from canhaptic.lab.studies.runner import pool_of
from canhaptic.scene.displays import display_properties
from canhaptic.scene.method import simulation_of
from canhaptic.scene.models import AxisScene, AxisSimulation, Scene
from canhaptic.sim.plant.user import UserParameters
from canhaptic.sim.plant.velocity_drive import AdmittanceSimulation

Progress = Callable[[int, int], None]
TOLERANCE: Final = 0.05
MARGIN: Final = 0.2
_DECADES: Final = 4.0
"""Decades of damping that are tried, below the limit of rendering."""
_DIGITS: Final = 3
_SHARES: Final = (1.0, 0.6, 0.3)
"""Fractions of the largest stiffness for which the largest damping is shown, as the trade-off of the two."""
_BELOW: Final = (0.2, 0.4, 0.6, 0.8, 1.0)
"""Fractions of a stiffness with which a damping must also pass."""


class _Places(NamedTuple):
    """Number of walls that are tried in each step of a search."""

    stiffnesses: tuple[int, ...]  # in the whole range, then in each interval found
    dampings: tuple[int, ...]  # the same
    below: int  # stiffnesses, and dampings, at which walls below the answer are tried

    @property
    def most(self) -> int:
        """Largest number of walls of a whole search."""
        return sum(self.stiffnesses) + len(_SHARES) * len(_BELOW) * sum(self.dampings) + self.below**2 + 1


_COMPILED: Final = _Places((128, 64), (32, 32), 10)
_ONE_BY_ONE: Final = _Places((12, 6, 6), (8, 6), 5)
_COSTLY: Final = _Places((12, 6), (6,), 3)
"""Numbers of walls if Python runs the loop of several motors, which takes four times as long as that of an axis."""


def design(
    scene: Scene,
    margin: float = MARGIN,
    tolerance: float = TOLERANCE,
    engine: Engine = "auto",
    progress: Progress = lambda _tried, _most: None,
) -> Row:
    """Return the stiffest wall for the rig of a scene, and the largest damping at that stiffness, as plain values.

    For admittance displays it is the lightest mass of each, see `design_masses`.

    Args:
        scene: Simulated scene of one group; or scene of one axis, simulated or with `passivity.moving_mass` declared.
        margin: Relative reserve by which stiffness and damping could both be larger and still pass.
        tolerance: Largest relative difference of a rendering from the requested one.
        engine: Engine of the trials, as for a sweep.
        progress: Called with the number of walls tried, and the largest possible number.

    Raises:
        InputError: The scene cannot be designed for, or a margin or tolerance is out of range.
        CheckFailedError: Not even the softest wall passes.
    """
    if is_display(scene):
        return design_masses(scene, margin, tolerance, progress)
    require_design_room(margin, tolerance)
    port = scene.ports[0]
    trial = (trials.NetworkTrial if port.section else trials.Trial)(scene, tolerance, engine)
    cores = (os.cpu_count() or 1) if trial.is_costly and not trial.is_quick else 1
    with pool_of(cores) as pool:
        trial.executor = None if pool is None else pool.executor
        found = _designed(trial, margin, tolerance, progress)
    return found if "network" in found else {**found, "replaces": port.rendered.name}


def _designed(trial: trials.Trial | trials.NetworkTrial, margin: float, tolerance: float, progress: Progress) -> Row:
    search = _WallSearch(trial, 1.0 + margin, progress)
    stiffest = search.largest_stiffness()
    stiffnesses = [_rounded(share * stiffest) for share in _SHARES]
    dampings = search.largest_dampings(np.array(stiffnesses))
    stiffness, damping = stiffnesses[0], dampings[0]
    below, verdict = search.below_and_at(stiffness, damping)
    result = trial.account(verdict, stiffness, damping)
    result |= {"margin": margin, "tolerance": tolerance, "walls": trial.walls}
    result |= {"tried_below": len(below), "failing_below": int((~below).sum())}
    result["trade"] = [{"stiffness": k, "damping": d} for k, d in zip(stiffnesses, dampings, strict=True)]
    return result


class _WallSearch:
    """Search in batches, one for the whole range and one per interval found; `factor` scales the walls tried."""

    def __init__(self, trial: trials.Trial | trials.NetworkTrial, factor: float, progress: Progress) -> None:
        self._trial, self._factor, self._progress = trial, factor, progress
        self._places = _COMPILED if trial.is_quick else _COSTLY if trial.is_costly else _ONE_BY_ONE
        progress(0, self._places.most)

    def largest_stiffness(self) -> float:
        """Return the largest stiffness without damping, rounded to a few digits.

        Raises:
            CheckFailedError: Not even the softest wall passes.
        """
        low, high = self._trial.softest, trials.STIFFEST / self._factor
        for places in self._places.stiffnesses:
            tried = np.geomspace(low, high, places)
            verdict = self._verdict(tried, np.zeros(places))
            last, first = _edges(verdict.passed, verdict.nearly)
            if last < 0 and low == self._trial.softest:
                raise self._nothing_passes(verdict)
            if first == places:
                return _rounded(high)
            low, high = float(tried[max(last, 0)]), float(tried[first])
        return _rounded(low)

    def _nothing_passes(self, verdict: trials.TrialVerdict) -> CheckFailedError:
        softest = f"{self._trial.softest * self._factor:g} {stiffness_unit(self._trial.unit)}"
        return CheckFailedError(
            f"{self._trial.scene.source}: not even {softest} is rendered within the tolerance "
            f"(stiffness {100.0 * float(verdict.stiffness_share[0]):.3g} % of what was asked, "
            f"{float(verdict.least_interaction[0]):.3g} J given out); raise bus.rate, or declare what is "
            f"certain (passivity.moving_mass, device_damping){self._trial.remedy}"
        )

    def largest_dampings(self, stiffnesses: Array) -> list[float]:
        """Return the largest damping at each stiffness, shape (n,), or 0 if none passes; all are searched at once."""
        highest = 4.0 * np.array([self._trial.damping_scale(stiffness) for stiffness in stiffnesses.tolist()])
        first, *others = self._places.dampings
        shares = np.concatenate([[0.0], np.logspace(-_DECADES, 0.0, first - 1)])
        low, high = self._between(stiffnesses, highest[:, None] * shares)
        for places in others:
            low, high = self._between(stiffnesses, np.linspace(low, high, places, axis=1))
        return [_rounded(damping) for damping in low.tolist()]

    def _between(self, stiffnesses: Array, dampings: Array) -> tuple[Array, Array]:
        """Return the last damping that passes and the first that is excluded, shape (n,) each.

        Args:
            stiffnesses: Shape (n,).
            dampings: Rising, shape (n, m). If all pass, both results are the last; if none does, both are the first.
        """
        walls = np.broadcast_arrays(stiffnesses[:, None, None] * np.array(_BELOW), dampings[:, :, None])
        verdict = self._verdict(*(wall.ravel() for wall in walls))
        passed, nearly = (np.all(found.reshape(walls[0].shape), axis=2) for found in (verdict.passed, verdict.nearly))
        edges = np.array([_edges(*row) for row in zip(passed, nearly, strict=True)]).clip(0, dampings.shape[1] - 1)
        rows = np.arange(len(dampings))
        return dampings[rows, edges[:, 0]], dampings[rows, edges[:, 1]]

    def below_and_at(self, stiffness: float, damping: float) -> tuple[trials.Booleans, trials.TrialVerdict]:
        """Return which weaker walls pass, and the verdict on the wall itself.

        A wall is accepted if all weaker walls pass too. They are tried with the factor, the wall itself without it.
        """
        parts = np.linspace(1.0 / self._places.below, 1.0, self._places.below)
        dampings = parts if damping else np.zeros(1)
        grid = np.array([(k, d) for k in parts for d in dampings])
        own = np.array([[1.0, 1.0]]) / self._factor
        verdict = self._verdict(*(np.concatenate([grid, own]) * (stiffness, damping)).T)
        return verdict.passed[:-1], verdict.last()

    def _verdict(self, stiffness: Array, damping: Array) -> trials.TrialVerdict:
        found = self._trial.verdict(self._factor * stiffness, self._factor * damping)
        self._progress(self._trial.walls, self._places.most)
        return found


def _edges(passed: trials.Booleans, nearly: trials.Booleans) -> tuple[int, int]:
    """Return the index of the last wall that passes, or -1, before the first that clearly fails, and that index too."""
    first = int(np.logical_and.accumulate(nearly).sum())
    return int(np.flatnonzero(np.append(True, passed[:first]))[-1]) - 1, first


def _rounded(value: float, towards: Callable[[float], int] = math.floor) -> float:
    """Return a value rounded down to a few digits, or by `math.ceil` up."""
    if value <= 0.0:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(value)) - _DIGITS + 1)
    slack = 1e-12 if towards is math.floor else -1e-12  # a value with as few digits stays as it is
    return float(f"{towards(value / unit * (1.0 + slack)) * unit:.{_DIGITS}g}")


_HANDS: Final = ((1.0, 1.0), (0.3, 1.0), (3.0, 1.0), (1.0, 0.3), (1.0, 3.0))
"""Hands that are tried: (mass at the grip, stiffness of the hand), as multiples of the scene's."""
_MASS_DURATION: Final = 2.0  # of a trial [s]
_MASSES: Final = (17, 7, 5)  # masses in the whole range, then in each interval found
_MASS_RANGE: Final = (0.05, 1.1)  # of the mass from which the guard never acts
_MASS_METRICS: Final = ("mass_felt", "mass_felt.share", "least_interaction", "guard_acts", "diverged", "uncertified")

_Figures = dict[str, float]


def design_masses(
    scene: Scene, margin: float, tolerance: float, progress: Progress = lambda _tried, _most: None
) -> Row:
    """Return the lightest mass for each display, and group of displays, of a scene, as plain values.

    Args:
        scene: Scene of admittance displays, simulated, each with a hand.
        margin: Relative reserve by which the mass could be smaller and still pass.
        tolerance: Largest relative difference of the apparent mass from the requested one.
        progress: Called with the number of masses tried, and the largest possible number.

    Raises:
        InputError: A display renders no virtual mass or has no hand, or a margin or tolerance is out of range.
        CheckFailedError: No mass passes.
    """
    require_design_room(margin, tolerance)
    trials, each = [_MassTrial(name, part, tolerance) for name, part in parts_of(scene).items()], sum(_MASSES) + 1
    found = {}
    for number, trial in enumerate(trials):

        def show(tried: int, before: int = number * each) -> None:
            progress(before + tried, len(trials) * each)

        found[trial.name] = _lightest(trial, margin, show)
    return {"scene": scene.source, "margin": margin, "tolerance": tolerance, "displays": found}


class _MassTrial:
    """One display, or group of displays, with its hands."""

    def __init__(self, name: str, scene: Scene, tolerance: float) -> None:
        self.name, self._scene, self._tolerance = name, scene, tolerance
        [port] = scene.ports
        part = port.rendered
        if not isinstance(part.parameters, AdmittanceMass | GroupMass) or isinstance(part.parameters, PathMass):
            raise InputError(f"{scene.source}: {name}: renders {part.name}, expected virtual_mass to design for")
        if any(simulation_of(axis).user is None for axis in scene.axes):
            raise InputError(f"{scene.source}: {name}: has no hand (simulation.user), expected one that moves it")
        self.never_acts = never_acts(scene)
        self.unit = mass_unit(scene.axes[0].parameters.unit)
        self.allowance = float(getattr(port.passivity.parameters, "energy_allowance", 0.0))

    def figures(self, mass: float) -> list[_Figures]:
        """Return the figures of a mass under every hand."""
        cycles = round(_MASS_DURATION / self._scene.bus.sample_time)
        scene = _with_mass(self._scene, mass)
        hands = [tuple(replace(axis, simulation=_held(axis, *hand)) for axis in scene.axes) for hand in _HANDS]
        return [run_scalar(replace(scene, axes=axes), cycles, _MASS_METRICS) for axes in hands]

    def passes(self, figures: list[_Figures]) -> bool:
        """Whether every hand feels the requested mass and no energy is generated."""
        floor = -self.allowance - PASSIVE_TOLERANCE
        is_kept = all(of["diverged"] == 0.0 and of["least_interaction"] >= floor for of in figures)
        return is_kept and self.off(figures) <= self._tolerance

    def off(self, figures: list[_Figures]) -> float:
        """Return the deviation of the felt from the requested mass, for the worst hand."""
        shares = [abs(of["mass_felt.share"] - 1.0) for of in figures]
        return 1e9 if np.isnan(shares).any() else max(shares)


def _lightest(trial: _MassTrial, margin: float, progress: Callable[[int], None]) -> Row:
    """Return the result for the lightest mass, searched from heavy to light; `progress` gets the masses tried.

    Raises:
        CheckFailedError: No mass passes.
    """
    low, high = (share * trial.never_acts for share in _MASS_RANGE)
    tried, most = 0, 0.0
    nearest: tuple[float, float, list[_Figures]] = (np.inf, low, [])
    for places in _MASSES:
        passed = 0.0
        for mass in np.geomspace(low, high, places)[::-1].tolist():
            figures = trial.figures(mass)
            tried += 1
            progress(tried)
            if trial.passes(figures):
                passed, most = mass, max(most, mass)
            elif passed or most:
                low = mass
                break
            else:
                nearest = min(nearest, (trial.off(figures), mass, figures), key=lambda one: one[:2])
        if not most:
            raise CheckFailedError(f"{trial.name}: {_why_no_mass(nearest[2], nearest[1], trial)}")
        high = passed or high
    mass = _rounded(high * (1.0 + margin), math.ceil)
    found = _account_of_mass(trial, mass, trial.figures(mass))
    progress(tried + 1)
    return {**found, "passes": [high, most]}


def _why_no_mass(figures: list[_Figures], mass: float, trial: _MassTrial) -> str:
    shares = [of["mass_felt.share"] for of in figures]
    return (
        f"no mass is felt as asked by every hand; the nearest is {mass:.3g} {trial.unit} (felt {min(shares):.3g} to "
        f"{max(shares):.3g} times that, {si(max(0.0, -min(of['least_interaction'] for of in figures)), 'J', 3)} given "
        "out): look for a hand that exceeds speed_limit or acceleration_limit, lower the uncertainty of the force "
        "(admittance.force.sampling: mean, slew, error), or raise bus.rate"
    )


def _account_of_mass(trial: _MassTrial, mass: float, figures: list[_Figures]) -> Row:
    """Return the figures of a mass; the worst over all hands."""
    shares = [of["mass_felt.share"] for of in figures]
    return {
        "mass": mass,
        "unit": trial.unit,
        "never_acts": trial.never_acts,
        "mass_felt.share": [min(shares), max(shares)],
        "least_interaction": min(of["least_interaction"] for of in figures),
        "energy_allowance": trial.allowance,
        "guard_acts": max(of["guard_acts"] for of in figures),
        "uncertified": max(of["uncertified"] for of in figures),
        "hands": len(figures),
    }


def never_acts(scene: Scene) -> float:
    """Return the mass above which every display is passive unguarded: drive mass + loop gain * lag [kg or kg*m^2].

    For `guarded` it follows from the declared values, for another algorithm from those of the simulated plant.
    """
    return max(_of_axis(axis, scene) for axis in scene.axes)


def _of_axis(axis: AxisScene, scene: Scene) -> float:
    properties, simulation = display_properties(axis), simulation_of(axis)
    known = scene.port_of(axis).passivity.parameters
    lag = (properties.delay + 0.5 + properties.latency) * properties.sample_time
    lag += 0.5 / (np.pi * properties.filter) if properties.filter else 0.0
    if isinstance(known, GuardedAdmittanceParameters):
        return float(known.drive_mass + known.loop_gain * lag)
    return float(simulation.plant.mass + _servo(simulation).loop.gain * lag)


def _servo(simulation: AxisSimulation) -> AdmittanceSimulation:
    """Return what is simulated of a velocity loop and what is held."""
    return cast(AdmittanceSimulation, simulation.admittance)


def _held(axis: AxisScene, grip: float, stiffness: float) -> AxisSimulation:
    """Return a simulated axis with another hand."""
    simulation = simulation_of(axis)
    servo, user = _servo(simulation), cast(UserParameters, simulation.user)
    held = servo.grip.model_copy(update={"mass": grip * servo.grip.mass})
    hand = user.model_copy(update={"stiffness": stiffness * user.stiffness})
    return replace(simulation, admittance=servo.model_copy(update={"grip": held}), user=hand)


def _with_mass(scene: Scene, mass: float) -> Scene:
    [port] = scene.ports
    heavier = port.rendered._replace(parameters=port.rendered.parameters.model_copy(update={"mass": mass}))
    return scene.with_port(port._replace(rendered=heavier))


def mass_snippets(result: Row) -> dict[str, str]:
    """Return each mass as YAML for a scene; `result` as `design` returns it for displays."""
    return {name: _snippet(found) for name, found in result["displays"].items()}


def _snippet(found: Row) -> str:
    environment = {"type": "virtual_mass", "mass": f"{found['mass']:g} {found['unit']}"}
    return str(yaml.safe_dump({"environment": environment}, sort_keys=False))


def mass_report(result: Row) -> RenderableType:
    """Return the text of a design for a terminal; `result` as `design_masses` returns it."""
    said = f"   target: within {100.0 * result['tolerance']:g} %, {100.0 * result['margin']:g} % reserve"
    parts = [Text.assemble(" ", (scene_title(result["scene"]), "bold"), said)]
    for name, found in result["displays"].items():
        low, high = found["mass_felt.share"]
        given, heaviest = si(max(0.0, -found["least_interaction"]), "J", 3), _MASS_RANGE[1] * found["never_acts"]
        lines = (
            "",
            f" {name}: lightest mass, tried with {found['hands']} hands",
            _snippet(found),
            f" masses tried that pass: {found['passes'][0]:.3g} to {found['passes'][1]:.3g} {found['unit']}",
            f" no mass over {heaviest:.3g} {found['unit']} was tried; the one to use has the reserve on the lightest",
            f" mass felt: {100.0 * low:.1f} to {100.0 * high:.1f} % of requested",
            f" energy given out: at most {given} (allowance {si(found['energy_allowance'], 'J', 3)})",
            f" commands limited by the guard: at most {100.0 * found['guard_acts']:.2g} %",
            f" lightest mass that is passive without the guard: {found['never_acts']:.3g} {found['unit']} (M + c tau)",
        )
        parts += map(Text, lines)
        if found["uncertified"]:
            parts.append(Text(f" NOT certified in {100.0 * found['uncertified']:.2g} % of the holds", "yellow"))
    return Group(*parts)
