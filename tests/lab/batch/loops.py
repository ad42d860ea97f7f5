"""Loops for the tests of the batch: many at once, and the same ones by the classes of the cycle."""

from typing import Any

import numpy as np

from canhaptic.control.environments import ENVIRONMENTS, plain
from canhaptic.lab.batch.cases import BatchCase
from canhaptic.lab.batch.closed_loop import commanded, measured
from canhaptic.lab.batch.scalar import loop_settings
from canhaptic.lab.figures.figures import METRICS, metrics_of, sums_of
from canhaptic.lab.figures.meter import Meter, take
from canhaptic.lab.loop.axis_loop import LoopCase
from canhaptic.registry import load
from canhaptic.sim.plant.plant import PlantParameters
from canhaptic.sim.plant.user import SinusoidMotion, UserParameters
from tools.bench.standard_cases import loop_in_arrays, standard_case

PLANT = PlantParameters(mass=0.25, damping=0.1, initial_position=0.002)
USER = UserParameters(stiffness=300.0, damping=3.0, motion=SinusoidMotion(amplitude=0.03, frequency=4.0))
COUNTED = ("diverged", "cycles")

WORLDS: dict[str, dict[str, Any]] = {
    "spring_damper_wall": {"stiffness": 1000.0, "damping": 5.0, "position": 0.001},
    "two_sided_wall": {"stiffness": 1000.0, "damping": 5.0, "lower": -0.01, "upper": 0.01},
    "hardening_wall": {"stiffness": 500.0, "hardening": 1e6, "damping": 2.0},
    "detents": {"peak": 1.0, "pitch": 0.01, "damping": 0.5},
    "viscous_medium": {"damping": 3.0},
    "viscoelastic_medium": {"stiffness": 300.0, "relaxation_time": 0.2, "damping": 1.0},
    "coulomb_surface": {"friction": 1.0, "stiffness": 2000.0, "damping": 1.0},
    "damper_wall": {"damping": 5.0},
    "free_space": {},
}


def scalar_case(world: str, algorithm: str, **named: Any) -> LoopCase:
    """Returns one loop."""
    values = {**WORLDS[world], **named.pop("environment", {})}
    environment: Any = load(ENVIRONMENTS, world, "environment")(**values)
    if algorithm == "energy_bounding":
        named.setdefault("declared_damping", 0.05)
    return standard_case(environment, algorithm, named.pop("rate", 1000.0), USER, plant=PLANT, **named)


def in_arrays(case: LoopCase, numbers: dict[str, np.ndarray] | None = None) -> BatchCase:
    """Returns the same loop for many scenes."""
    return loop_in_arrays(case, PLANT, USER, numbers or {})


def with_floats(case: LoopCase, batch: BatchCase, cycles: int, last: int = 0) -> dict[str, float]:
    """Returns the figures of one loop by the controller of the cycle, its plant moved term by term in Python.

    Args:
        case: What the scalar classes are made of.
        batch: Whose flow is used; of numbers, not arrays.
        cycles: SYNCs.
        last: Those of the whole run, where they are not all run.
    """
    assert batch.linear is not None
    flow, states = batch.linear.flows[0].tolist(), batch.linear.starts.shape[1] - 2
    state = batch.linear.starts[0, :states].tolist()
    controller, loop, meter = case.controller(), loop_settings(case, last or cycles), Meter()
    held = waiting = interaction = before = 0.0
    for k in range(cycles):
        if k:
            known = [*state, held, 1.0]
            state = []
            for row in range(states):
                total = 0.0
                for column in range(states + 2):
                    total += flow[row][column] * known[column]
                state.append(total)
        interaction -= held * (state[0] - before)
        before = state[0]
        position = measured(loop, state[0])
        balance = controller.step(position, held)
        take(plain(case.environment), loop.meter, meter, k, position, state[0], held, interaction, balance)
        command = commanded(loop, balance.torque)
        held, waiting = (waiting, command) if loop.delay else (command, 0.0)
    names = [name for name in METRICS if name not in COUNTED]
    sums = {name: np.array([getattr(meter, name)]) for name in sums_of(names)}
    return {name: float(values[0]) for name, values in metrics_of(names, sums).items()}
