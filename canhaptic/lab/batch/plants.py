"""The flow of many linear plants over one sample time, in arrays: mass, bearings and a hand that follows sinusoids.

    m v' = torque - b v + K (x_u - q) + D (v_u - v) + push   (`user` and `plant` of canhaptic.sim.plant)

The states are those of `Plant`, in its order, and so is the flow: exp(F T) by a series and doubling. The sum of a row
is taken term by term and not by a matrix product, so that a position may differ from that of `Plant` by a few units in
its last place per hold. Plants with other linear effects are made one by one, each different one once.
"""

from collections.abc import Mapping
from typing import Any, Final, cast

import numpy as np

from canhaptic.errors import ParameterError
from canhaptic.lab.batch.event_plants import PlantValues, distinct_plants, works_are_booked
from canhaptic.lab.batch.signal_effects import SIGNAL_EFFECTS
from canhaptic.lab.loop.axis_loop import Array
from canhaptic.scene.models import AxisSimulation
from canhaptic.scene.parts import build_plant
from canhaptic.sim.plant.plant import Plant
from canhaptic.sim.plant.propagator import flow_changes
from canhaptic.sim.plant.user import UserParameters

_IN_ARRAYS: Final = ("viscous_friction", "tremor")
"""Effects whose place in the equation of motion is known here."""
_ANY_NS: Final = 1_000_000
"""A sample time, where it does not matter [ns]."""
_Numbers = dict[str, Array | float]


def is_linear(simulation: AxisSimulation) -> bool:
    """Whether one flow moves a plant, and the motor's work is the held torque times displacement.

    Raises:
        ParameterError: An effect does not fit the plant.
    """
    scene = PlantValues(simulation, _ANY_NS).scene()
    moves_by_flow = not (any(part.has_guards for part in scene.parts) or scene.efforts or scene.schedule)
    return moves_by_flow and not works_are_booked(scene)


def why_not_in_loop(simulation: AxisSimulation) -> str:
    """Return "" when a loop of a batch can move a plant, else the reason by name."""
    try:
        scene = PlantValues(simulation, _ANY_NS).scene()
    except ParameterError as error:
        return f"effect {error.part} does not stand alone ({error})"
    own = any(not hasattr(effort, "effort") for effort in scene.efforts)
    return "a force of the plant is own code" if own else ""


def plant_numbers(simulation: AxisSimulation, sample_time_ns: Array | float, varied: Mapping[str, Array]) -> _Numbers:
    """Return start, flow and rates of many plants by the names of `BatchCase.numbers`; a coefficient of 0 is left out.

    Args:
        simulation: Common part of the scenes.
        sample_time_ns: One value, or one for each scene, shape (n_scenes,) [ns].
        varied: Keys under `simulation.` -> value of each scene.
    """
    keys = {key: values for key, values in varied.items() if key.startswith("simulation.")}
    known = all(effect.name in (*_IN_ARRAYS, *SIGNAL_EFFECTS) for effect in simulation.effects)
    rates: Array | None = None
    if known:
        rates, start = _in_arrays(simulation, keys)
    if not keys and isinstance(sample_time_ns, float):
        plant = _plant(simulation, int(sample_time_ns))
        flows, start = plant.whole_flow()[None], plant.initial_state()[None]
    elif rates is None:
        flows, start = _one_by_one(simulation, sample_time_ns, keys)
    else:
        flows = np.eye(rates.shape[-1]) + flow_changes(
            rates * np.reshape(np.asarray(sample_time_ns) * 1e-9, (-1, 1, 1))
        )
    begin: _Numbers = {f"start.{row}": _shared(start[:, row]) for row in range(flows.shape[-1] - 2)}
    return begin | _named("flow", flows) | ({} if rates is None else _named("rate", rates))


def _named(name: str, matrices: Array) -> _Numbers:
    """Return the entries of the rows of the states that are not 0 everywhere."""
    size = matrices.shape[-1]
    places = [(row, column) for row in range(size - 2) for column in range(size)]
    return {f"{name}.{i}.{j}": _shared(matrices[:, i, j]) for i, j in places if matrices[:, i, j].any()}


def _shared(values: Array) -> Array | float:
    """One number where all scenes share it."""
    return float(values[0]) if (values == values[0]).all() else np.ascontiguousarray(values)


def _plant(simulation: AxisSimulation, sample_time_ns: int) -> Plant:
    return build_plant(simulation, sample_time_ns)


def _in_arrays(simulation: AxisSimulation, keys: Mapping[str, Array]) -> tuple[Array, Array]:
    """Return the rates of change [1/s], shape (n, k, k), and the states at the start, shape (n, k)."""
    user = simulation.user or UserParameters()

    def number(name: str, value: float) -> Any:
        return keys.get(f"simulation.{name}", value)

    plant = {
        name: number(f"plant.{name}", getattr(simulation.plant, name)) for name in type(simulation.plant).model_fields
    }
    hand = {name: number(f"user.{name}", getattr(user, name)) for name in ("stiffness", "damping", "push", "rest")}
    damping, rest = plant["damping"] + hand["damping"], hand["rest"]
    motions = []  # (amplitude, angular frequency, phase)
    if user.motion is not None:
        motion = {name: number(f"user.motion.{name}", getattr(user.motion, name)) for name in
                  ("amplitude", "frequency", "phase", "offset")}  # fmt: skip
        motions.append((motion["amplitude"], 2.0 * np.pi * motion["frequency"], motion["phase"]))
        rest = rest + motion["offset"]
    for effect in simulation.effects:
        found = cast(Any, effect.parameters)
        if effect.name == "tremor":
            motions.append((found.amplitude, 2.0 * np.pi * found.frequency, found.phase))
        elif effect.name == "viscous_friction":
            damping = damping + found.damping
    count = max([1, *(len(values) for values in keys.values())])
    size = 4 + 2 * len(motions)
    rates, start = np.zeros((count, size, size)), np.zeros((count, size))
    start[:, 0], start[:, 1], start[:, -1] = plant["initial_position"], plant["initial_velocity"], 1.0
    rates[:, 0, 1] = 1.0
    force = rates[:, 1]
    force[:, 0], force[:, 1], force[:, -2] = -hand["stiffness"], -damping, 1.0
    force[:, -1] = hand["stiffness"] * rest + hand["push"]
    for i, (amplitude, omega, phase) in enumerate(motions):
        sine, cosine = 2 + 2 * i, 3 + 2 * i
        force[:, sine], force[:, cosine] = hand["stiffness"] * amplitude, hand["damping"] * amplitude * omega
        rates[:, sine, cosine], rates[:, cosine, sine] = omega, -omega
        start[:, sine], start[:, cosine] = np.sin(phase), np.cos(phase)
    force /= np.reshape(plant["mass"], (-1, 1))
    return rates, start


def _one_by_one(
    simulation: AxisSimulation, sample_time_ns: Array | float, keys: Mapping[str, Array]
) -> tuple[Any, Any]:
    distinct, which = distinct_plants(simulation, sample_time_ns, keys)
    plants = [_plant(*values) for values in distinct]
    flows, start = np.array([p.whole_flow() for p in plants]), np.array([p.initial_state() for p in plants])
    return flows[which], start[which]
