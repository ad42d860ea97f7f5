"""What is measured on one rig under every algorithm: K-B plot, impedance, time of a step; and the M-width of the rig.

A wall counts as passive where the display is, device included: after no hold has more energy come out than went in and
than what damping and friction of the device dissipate at least. Colgate's condition asks the same of every hand; here
one hand moves in and out of the wall. So an algorithm may pass above Colgate's line, and none may fail below it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.verdict import PASSIVE_TOLERANCE
from canhaptic.errors import ParameterError
from canhaptic.lab.batch import run_batch, run_scalar, scene_with, why_not_batchable
from canhaptic.lab.figures.field_figures import asked_impedance, m_width, rendered_impedance, stiffest_walls
from canhaptic.lab.loop.axis_loop import Array, LoopCase, LoopRun, render
from canhaptic.lab.loop.cost import microseconds_per_step
from canhaptic.lab.loop.scenes import cycles_of, loop_case
from canhaptic.lab.studies.arena.arena_cases import label_of, rounded, scene_under, with_loop
from canhaptic.lab.studies.map.theory import theory_of
from canhaptic.scene.components import ComponentSpec
from canhaptic.scene.models import Scene
from canhaptic.scene.torque_history import simulation_of
from canhaptic.sim.plant.user import SinusoidMotion, UserParameters

DAMPINGS: Final = (0.0, 0.05, 0.1, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0)  # [N*s/m]
_STIFFNESSES: Final = (1e2, 1e6)  # [N/m]
FREQUENCIES: Final = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)  # [Hz]
_SPRING: Final = SpringDamperWall(stiffness=1000.0, damping=5.0)
"""What the impedance is measured of: the hand presses on it with `_PRESS` and never leaves it."""
_HAND: Final = UserParameters(stiffness=2000.0, damping=20.0)
_AMPLITUDE: Final = 5e-3  # [m]
_PRESS: Final = -0.05  # middle of the motion of the hand [m]
_METRICS: Final = ("diverged", "least_covered", "stiffness_rendered.share")
_RATES: Final = (100.0, 300.0, 1000.0, 3000.0, 8000.0)
"""Rates of the M-width [Hz]."""
_REPEATS: Final = 5
Rows = list[dict[str, Any]]


def tried_stiffnesses(per_decade: int) -> Array:
    """Return the stiffnesses of the K-B plot, rising by equal factors, both ends included, shape (n,) [N/m]."""
    least, most = _STIFFNESSES
    return np.geomspace(least, most, 1 + round(per_decade * np.log10(most / least)))


def borders(rig: Path, algorithm: str, delay: int, per_decade: int, *, allow_code: bool = False) -> Rows:
    """Return the K-B plot of an algorithm: over the damping the stiffest passive wall, and the stiffest near one.

    Args:
        rig: Scene of one axis with a wall.
        algorithm: Name, or `FILE.py:Class`.
        delay: Whole holds, 0 or 1.
        per_decade: Stiffnesses in a decade.
        allow_code: Whether the file may run.
    """
    stiffnesses = tried_stiffnesses(per_decade)
    try:
        scene = _at_delay(scene_under(rig, algorithm, allow_code=allow_code), delay)
    except ParameterError:
        return []
    shape = len(stiffnesses), len(DAMPINGS)
    walls = {
        "environment.stiffness": np.repeat(stiffnesses, len(DAMPINGS)),
        "environment.damping": np.tile(DAMPINGS, len(stiffnesses)),
    }
    found = {name: values.reshape(shape) for name, values in _tried(scene, walls).items()}
    kept = (found["diverged"] == 0.0) & (found["least_covered"] >= -PASSIVE_TOLERANCE)
    border = stiffest_walls(stiffnesses, kept, found["stiffness_rendered.share"])
    passive, near, is_open = (values.tolist() for values in border)
    return [
        {"algorithm": label_of(algorithm), "delay": delay, "damping": damping, "passive": rounded(passive[i]),
         "near": rounded(near[i]), "open": is_open[i]}
        for i, damping in enumerate(DAMPINGS)
    ]  # fmt: skip


def _tried(scene: Scene, walls: Mapping[str, Array]) -> Mapping[str, Array]:
    """Return the figures of walls, compiled where the algorithm has a kernel."""
    cycles = cycles_of(scene, None)
    if not why_not_batchable(scene):
        return run_batch(scene, walls, cycles, metrics=_METRICS)
    rows = [dict(zip(walls, values, strict=True)) for values in zip(*(w.tolist() for w in walls.values()), strict=True)]
    found = [run_scalar(scene_with(scene, row), cycles, _METRICS) for row in rows]
    return {name: np.array([one[name] for one in found]) for name in _METRICS}


def _at_delay(scene: Scene, delay: int) -> Scene:
    return with_loop(scene, scene.bus.rate, delay)


def theory(rig: Path, delay: int) -> dict[str, Rows]:
    """Return the lines of theory in the K-B plot by name, each a list of damping and stiffness.

    They are those of the plain wall, and the largest stiffness that a certificate of `guarded` holds; see
    `lab.studies.map.theory`.
    """
    plain, ours = (_at_delay(scene_under(rig, name), delay) for name in ("unprotected", "guarded"))
    device = simulation_of(plain.axes[0]).plant.damping
    fine = [*np.linspace(0.0, device, 21).tolist(), *(damping for damping in DAMPINGS if damping > device)]
    found = {d: theory_of(scene_with(plain, {"environment.damping": d})) for d in fine}
    certified = theory_of(ours).certificate
    return {
        "Colgate, plain wall": _points({d: one.colgate for d, one in found.items()}),
        "eigenvalues, plain wall": _points({d: one.eigenvalues for d, one in found.items()}),
        "largest certificate of guarded": _points(dict.fromkeys(DAMPINGS, certified)),
    }


def _points(line: Mapping[float, float | None]) -> Rows:
    return [{"damping": rounded(d), "stiffness": rounded(k)} for d, k in line.items() if k]


def impedances(rig: Path, algorithm: str, delay: int, *, allow_code: bool = False) -> Rows:
    """Return the impedance that an algorithm renders over the one asked for, at each of `FREQUENCIES`.

    The environment is a spring with a damper, always in contact: size of the ratio, and its angle [rad].
    """
    try:
        scene = _at_delay(scene_under(rig, algorithm, allow_code=allow_code), delay)
    except ParameterError:
        return []
    found = []
    for frequency in FREQUENCIES:
        run, period = _shaken(scene, frequency), scene.bus.sample_time
        asked = asked_impedance(_SPRING.stiffness, _SPRING.damping, frequency)
        ratio = complex(np.nan) if run.ended else rendered_impedance(run, period, frequency) / asked
        size, angle = (rounded(float(part)) if np.isfinite(part) else None for part in (abs(ratio), np.angle(ratio)))
        case = {"algorithm": label_of(algorithm), "delay": delay, "frequency": frequency}
        found.append({**case, "size": size, "angle": angle})
    return found


def _shaken(scene: Scene, frequency: float) -> LoopRun:
    [axis] = scene.axes
    motion = SinusoidMotion(amplitude=_AMPLITUDE, frequency=frequency, offset=_PRESS)
    user = _HAND.model_copy(update={"motion": motion})
    simulation = replace(simulation_of(axis), user=user)
    environment = ComponentSpec("spring_damper_wall", _SPRING)
    case = loop_case(replace(axis, environment=environment, simulation=simulation), scene)
    return render(case, cycles_of(scene, 2.0))


def times_of_steps(rig: Path, algorithms: Sequence[str], *, allow_code: bool = False) -> dict[str, float]:
    """Return the time of a step [us] of each algorithm on the rig, interleaved; of this machine at this moment."""
    cases: dict[str, tuple[LoopCase, LoopRun]] = {}
    for name in algorithms:
        try:
            scene = scene_under(rig, name, allow_code=allow_code)
        except ParameterError:
            continue
        case = loop_case(scene.axes[0], scene)
        cases[label_of(name)] = case, render(case, cycles_of(scene, None))
    return {name: rounded(time) for name, time in microseconds_per_step(cases, _REPEATS).items()}


def mass_widths(rig: Path) -> Rows:
    """Return the M-width of the rig at several rates and delays: no algorithm of one torque axis renders a mass."""
    plant = simulation_of(scene_under(rig, "unprotected").axes[0]).plant
    found = []
    for rate in _RATES:
        for delay in (0, 1):
            width = m_width(plant.mass, plant.damping, 1.0 / rate, delay)
            found.append({"rate": rate, "delay": delay, "least": rounded(width.least), "most": rounded(width.most)})
    return found
