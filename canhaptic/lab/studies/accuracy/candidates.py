"""Every way to compute one plant under given torques: our settings, fixed-step methods, LSODA, MuJoCo.

The price that is the same on every machine is the number of evaluations of the equations of motion: a matrix-vector
product of ours that was tried, a right-hand side of a textbook method (forces looked at for a guard counted too), a
step of MuJoCo. It ranks like time; the study reports how well it did.
"""

import importlib.util
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

from canhaptic.extras import install_hint
from canhaptic.lab.judge.event_location import located
from canhaptic.lab.judge.fixed_step import METHODS, fixed_step
from canhaptic.lab.reference.continuous_reference import textbook_model
from canhaptic.lab.studies.accuracy.mujoco_plant import MujocoPlant, inexpressible
from canhaptic.scene.models import AxisSimulation
from canhaptic.scene.parts import build_plant
from canhaptic.sim.plant.accuracy_parameters import AccuracyParameters
from canhaptic.sim.plant.plant import Plant
from canhaptic.sim.plant.plant_motion import Motion, observed

OURS: Final = "canhaptic"
COMPILED: Final = "canhaptic, compiled"
LSODA: Final = "LSODA, located"
MUJOCO: Final = "MuJoCo"
_SUBSTEPS: Final = (1, 2, 4, 8, 16)
_TOLERANCES: Final = (1e-3, 1e-5, 1e-7, 1e-9)
_ABSOLUTE: Final = 1e-3
"""Absolute tolerance over relative."""
_MOST_WORK: Final = 130_000
"""Most evaluations of a fixed-step method in one run: finer rungs are left out."""
_WORK: Final = {"semi-implicit Euler": 1, "implicit midpoint": 8, "RK4": 4}
"""Per step, about, in right-hand sides."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """One method at one setting.

    Attributes:
        method: Its name.
        setting: What distinguishes it from others of the same method.
        size: Its step, relative; for fitting the order. None where there is no step.
        order: Declared; None for exact and adaptive methods.
        accuracy: As a scene names it; None for what no scene can name.
        observe: Runs it; returns motion, evaluations and events.
        spend: Runs it for its time only.
    """

    method: str
    setting: str
    size: float | None
    order: int | None
    accuracy: AccuracyParameters | None
    observe: Callable[[], tuple[Motion, int, int]]
    spend: Callable[[], object]

    @property
    def name(self) -> str:
        """Method and setting."""
        return f"{self.method}, {self.setting}"


def candidates(
    simulation: AxisSimulation,
    torques: Sequence[float],
    sample_time_ns: int,
    settings: Sequence[AccuracyParameters],
) -> list[Candidate]:
    """Return the whole ladder of one plant.

    Args:
        simulation: The plant, the user and the effects.
        torques: Torque of each hold [N or N*m].
        sample_time_ns: Duration of a hold [ns].
        settings: Settings of our plant.
    """
    found = [ours(simulation, accuracy, torques, sample_time_ns) for accuracy in settings]
    for method, (order, _) in METHODS.items():
        for substeps in _SUBSTEPS:
            if substeps * _WORK[method] * len(torques) <= _MOST_WORK:
                found.append(_fixed(simulation, method, order, substeps, torques, sample_time_ns))
    if importlib.util.find_spec("scipy"):
        found += [_adaptive(simulation, tolerance, torques, sample_time_ns) for tolerance in _TOLERANCES]
    if importlib.util.find_spec("mujoco") and not inexpressible(simulation):
        for integrator in ("Euler", "RK4"):
            found += [_mujoco(simulation, integrator, n, torques, sample_time_ns) for n in (1, 4, 16)]
    return found


def remarks(simulation: AxisSimulation) -> list[str]:
    """Return what could not be run, and why."""
    lines = []
    if not importlib.util.find_spec("mujoco"):
        lines.append(f"MuJoCo: not installed ({install_hint('bench')})")
    elif inexpressible(simulation):
        lines.append(f"MuJoCo: the scene cannot be expressed there ({', '.join(inexpressible(simulation))})")
    return lines


def ours(
    simulation: AxisSimulation,
    accuracy: AccuracyParameters,
    torques: Sequence[float],
    sample_time_ns: int,
    *,
    compiled: bool = False,
) -> Candidate:
    """Return our plant at one accuracy; compiled, it is a method of its own, for its time."""
    solved = replace(simulation, accuracy=accuracy)
    kept = build_plant(solved, sample_time_ns, compiled=compiled)

    def observe() -> tuple[Motion, int, int]:
        plant = build_plant(solved, sample_time_ns, compiled=compiled)
        return observed(plant, torques), plant.products, plant.events

    return Candidate(
        COMPILED if compiled else OURS,
        _setting_of(accuracy, kept),
        1.0 / accuracy.substeps,
        None,
        accuracy,
        observe,
        lambda: stepped(kept, torques),
    )


def _setting_of(accuracy: AccuracyParameters, plant: Plant) -> str:
    """Return what of an accuracy matters to a plant."""
    words = []
    if any(part.has_guards for part in plant.scene.parts):
        words.append(f"{accuracy.event_bits} bits")
    if not plant.is_exact:
        words.append(counted(accuracy.substeps, "substep"))
    return ", ".join(words) or "exact"


def counted(count: int, what: str) -> str:
    """Return a number of things in words."""
    return f"{count} {what}{'s' if count > 1 else ''}"


def stepped(plant: Plant, torques: Sequence[float]) -> None:
    """Move a plant from its start, as a drive does: one call a hold."""
    plant.reset()
    plant.begin(0)
    move, period, now = plant.advance_to, plant.sample_time_ns, 0
    for torque in torques:
        now += period
        move(now, torque)


def _fixed(
    simulation: AxisSimulation, method: str, order: int, substeps: int, torques: Sequence[float], sample_time_ns: int
) -> Candidate:
    def run() -> tuple[Motion, int, int]:
        model = textbook_model(simulation)
        motion = fixed_step(model, torques, sample_time_ns, METHODS[method][1](), substeps)
        return motion, model.evaluations, 0

    return Candidate(method, counted(substeps, "step"), 1.0 / substeps, order, None, run, run)


def _adaptive(simulation: AxisSimulation, tolerance: float, torques: Sequence[float], sample_time_ns: int) -> Candidate:
    def run() -> tuple[Motion, int, int]:
        model = textbook_model(simulation)
        motion = located(model, torques, sample_time_ns, "LSODA", tolerance, tolerance * _ABSOLUTE)
        return motion, model.evaluations, 0

    return Candidate(LSODA, f"tolerance {tolerance:.0e}", None, None, None, run, run)


def _mujoco(
    simulation: AxisSimulation, integrator: str, substeps: int, torques: Sequence[float], sample_time_ns: int
) -> Candidate:
    plant = MujocoPlant(simulation, integrator, substeps, torques, sample_time_ns)
    price = (4 if integrator == "RK4" else 1) * substeps * len(torques)
    setting = counted(substeps, "step")
    return Candidate(
        f"{MUJOCO} {integrator}", setting, 1.0 / substeps, 1, None, lambda: (plant.motion(), price, 0), plant.run
    )  # order 1 for RK4 too: the hand's force is held over a step
