"""The lightest virtual mass that an admittance display renders within a tolerance, for its hand and for similar hands.

A mass passes if every hand feels it within the tolerance and the display generates at most the declared energy. Masses
up to 1.1 times `never_acts` are tried, from heavy to light; the answer is the last before one that fails, times
1 + margin.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np
import yaml
from rich.console import Group, RenderableType
from rich.text import Text

from canhaptic.axis_units import mass_unit, si
from canhaptic.control.admittance.admittance_environment import AdmittanceMass
from canhaptic.control.admittance.group_environment import GroupMass, PathMass
from canhaptic.control.admittance.velocity_loop import GuardedAdmittanceParameters
from canhaptic.control.verdict import PASSIVE_TOLERANCE
from canhaptic.errors import CheckFailedError, InputError
from canhaptic.lab.figures.figures import display_figures
from canhaptic.lab.loop.axis_loop import parts_of, require_design_room
from canhaptic.lab.studies import Row
from canhaptic.scene.components import ComponentSpec
from canhaptic.scene.displays import display_properties
from canhaptic.scene.method import simulation_of
from canhaptic.scene.models import AxisScene, AxisSimulation, Scene

_HANDS: Final = ((1.0, 1.0), (0.3, 1.0), (3.0, 1.0), (1.0, 0.3), (1.0, 3.0))
"""Hands that are tried: (mass at the grip, stiffness of the hand), as multiples of the scene's."""
_DURATION: Final = 2.0  # of a trial [s]
_PLACES: Final = (17, 7, 5)  # masses in the whole range, then in each interval found
_RANGE: Final = (0.05, 1.1)  # of the mass from which the guard never acts
_DIGITS: Final = 3
_METRICS: Final = ("mass_felt", "mass_felt.share", "least_interaction", "guard_acts", "diverged", "uncertified")

Progress = Callable[[int, int], None]
_Figures = dict[str, float]


def design_displays(
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
    trials, each = [_Trial(name, part, tolerance) for name, part in parts_of(scene).items()], sum(_PLACES) + 1
    found = {}
    for number, trial in enumerate(trials):
        shown = partial(_show, progress, number * each, len(trials) * each)
        found[trial.name] = _lightest(trial, margin, shown)
    return {"scene": scene.source, "margin": margin, "tolerance": tolerance, "displays": found}


def _show(progress: Progress, before: int, most: int, tried: int) -> None:
    progress(before + tried, most)


class _Trial:
    """One display, or group of displays, with its hands."""

    def __init__(self, name: str, scene: Scene, tolerance: float) -> None:
        self.name, self._scene, self._tolerance = name, scene, tolerance
        part = scene.groups[0].network if scene.groups else scene.axes[0].environment
        if not isinstance(part.parameters, AdmittanceMass | GroupMass) or isinstance(part.parameters, PathMass):
            raise InputError(f"{scene.source}: {name}: renders {part.name}, expected virtual_mass to design for")
        if any(simulation_of(axis).user is None for axis in scene.axes):
            raise InputError(f"{scene.source}: {name}: has no hand (simulation.user), expected one that moves it")
        self.never_acts = never_acts(scene)
        self.unit = mass_unit(scene.axes[0].parameters.unit)
        spec = scene.groups[0].passivity if scene.groups else scene.axes[0].passivity
        self.allowance = float(getattr(spec.parameters, "energy_allowance", 0.0))

    def figures(self, mass: float) -> list[_Figures]:
        """Return the figures of a mass under every hand."""
        cycles = round(_DURATION / self._scene.bus.sample_time)
        scene = _with_mass(self._scene, mass)
        hands = [tuple(replace(axis, simulation=_held(axis, *hand)) for axis in scene.axes) for hand in _HANDS]
        return [display_figures(replace(scene, axes=axes), cycles, _METRICS) for axes in hands]

    def passes(self, figures: list[_Figures]) -> bool:
        """Whether every hand feels the requested mass and no energy is generated."""
        floor = -self.allowance - PASSIVE_TOLERANCE
        is_kept = all(of["diverged"] == 0.0 and of["least_interaction"] >= floor for of in figures)
        return is_kept and self.off(figures) <= self._tolerance

    def off(self, figures: list[_Figures]) -> float:
        """Return the deviation of the felt from the requested mass, for the worst hand."""
        shares = [abs(of["mass_felt.share"] - 1.0) for of in figures]
        return 1e9 if np.isnan(shares).any() else max(shares)


def _lightest(trial: _Trial, margin: float, progress: Callable[[int], None]) -> Row:
    """Return the result for the lightest mass, searched from heavy to light; `progress` gets the masses tried.

    Raises:
        CheckFailedError: No mass passes.
    """
    low, high = (share * trial.never_acts for share in _RANGE)
    tried, most = 0, 0.0
    nearest: tuple[float, float, list[_Figures]] = (np.inf, low, [])
    for places in _PLACES:
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
            raise CheckFailedError(f"{trial.name}: {_why(nearest[2], nearest[1], trial)}")
        high = passed or high
    mass = _rounded_up(high * (1.0 + margin))
    found = _account(trial, mass, trial.figures(mass))
    progress(tried + 1)
    return {**found, "passes": [high, most]}


def _why(figures: list[_Figures], mass: float, trial: _Trial) -> str:
    shares = [of["mass_felt.share"] for of in figures]
    return (
        f"no mass is felt as asked by every hand; the nearest is {mass:.3g} {trial.unit} (felt {min(shares):.3g} to "
        f"{max(shares):.3g} times that, {si(max(0.0, -min(of['least_interaction'] for of in figures)), 'J', 3)} given "
        "out): look for a hand that exceeds speed_limit or acceleration_limit, lower the uncertainty of the force "
        "(admittance.force.sampling: mean, slew, error), or raise bus.rate"
    )


def _account(trial: _Trial, mass: float, figures: list[_Figures]) -> Row:
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
    known = (scene.groups[0].passivity if scene.groups else axis.passivity).parameters
    lag = (properties.delay + 0.5 + properties.latency) * properties.sample_time
    lag += 0.5 / (np.pi * properties.filter) if properties.filter else 0.0
    if isinstance(known, GuardedAdmittanceParameters):
        return float(known.drive_mass + known.loop_gain * lag)
    gain = 0.0 if simulation.admittance is None else simulation.admittance.loop.gain
    return float(simulation.plant.mass + gain * lag)


def _held(axis: AxisScene, grip: float, stiffness: float) -> AxisSimulation:
    """Return a simulated axis with another hand."""
    simulation = simulation_of(axis)
    display, user = simulation.admittance, simulation.user
    if display is None or user is None:
        return simulation
    held = display.grip.model_copy(update={"mass": grip * display.grip.mass})
    hand = user.model_copy(update={"stiffness": stiffness * user.stiffness})
    return replace(simulation, admittance=display.model_copy(update={"grip": held}), user=hand)


def _with_mass(scene: Scene, mass: float) -> Scene:
    def heavier(spec: ComponentSpec) -> ComponentSpec:
        return spec._replace(parameters=spec.parameters.model_copy(update={"mass": mass}))

    if scene.groups:
        (group,) = scene.groups
        return replace(scene, groups=(replace(group, network=heavier(group.network)),))
    (axis,) = scene.axes
    return replace(scene, axes=(replace(axis, environment=heavier(axis.environment)),))


def _rounded_up(value: float) -> float:
    unit = 10.0 ** (np.floor(np.log10(value)) - _DIGITS + 1)
    return float(f"{np.ceil(value / unit * (1.0 - 1e-12)) * unit:.{_DIGITS}g}")


def display_snippet(found: Row) -> str:
    """Return the mass as YAML for a scene."""
    environment = {"type": "virtual_mass", "mass": f"{found['mass']:g} {found['unit']}"}
    return str(yaml.safe_dump({"environment": environment}, sort_keys=False))


def display_design_report(result: Row) -> RenderableType:
    """Return the text of a design for a terminal; `result` as `design_displays` returns it."""
    said = f"   target: within {100.0 * result['tolerance']:g} %, {100.0 * result['margin']:g} % reserve"
    parts = [Text.assemble(" ", (str(result["scene"]), "bold"), said)]
    for name, found in result["displays"].items():
        low, high = found["mass_felt.share"]
        given = si(max(0.0, -found["least_interaction"]), "J", 3)
        lines = (
            "",
            f" {name}: lightest mass, tried with {found['hands']} hands",
            display_snippet(found),
            f" masses that pass: {found['passes'][0]:.3g} to {found['passes'][1]:.3g} {found['unit']}",
            f" mass felt: {100.0 * low:.1f} to {100.0 * high:.1f} % of requested",
            f" energy given out: at most {given} (allowance {si(found['energy_allowance'], 'J', 3)})",
            f" commands limited by the guard: at most {100.0 * found['guard_acts']:.2g} %",
            f" passive without a guard from M + c tau = {found['never_acts']:.3g} {found['unit']} up",
        )
        parts += map(Text, lines)
        if found["uncertified"]:
            parts.append(Text(f" NOT certified in {100.0 * found['uncertified']:.2g} % of the holds", "yellow"))
    return Group(*parts)
