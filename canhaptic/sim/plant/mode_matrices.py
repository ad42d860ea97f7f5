"""PlantModel -> data of one mode: flows, work forms and guards. No scene-specific code is made or run."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from canhaptic.sim.plant.assembly import PlantModel, Rows
from canhaptic.sim.plant.guard_bounds import GuardBounds, guard_bounds
from canhaptic.sim.plant.propagator import Array, dyadic_flows

_Product = Callable[[Array, Array], object]


class Exit(NamedTuple):
    """Mode behind a guard."""

    part: int
    mode: str
    resets: tuple[tuple[int, Array], ...]
    work: int  # index of the work that takes the energy lost in the resets, -1 when there is none


class Mode(NamedTuple):
    """One mode as data."""

    key: tuple[str, ...]  # mode of each part
    flows: list[_Product]  # by level: z -> z after T / 2^level
    works: list[_Product]  # by level: z -> for each work [form times shifted z, unit row]; then the shifted z
    guards: Array  # values and rates of the guards, and the scaled rates of the state as rows, shape (2 c + m, n)
    bounds: GuardBounds
    exits: list[Exit]
    storage: Array  # P with z'Pz the stored energy


def compile_mode(scene: PlantModel, key: tuple[str, ...]) -> Mode:
    """Return the mode in which part i is in `key[i]`."""
    rows = Rows(scene)
    for part, mode in zip(scene.parts, key, strict=True):
        part.assemble(rows, mode)
    rows.close()
    for part, mode in zip(scene.parts, key, strict=True):
        part.constrain(rows, mode)
    names = list(scene.works)
    guards, exits = [], []
    for i, (part, mode) in enumerate(zip(scene.parts, key, strict=True)):
        work = names.index(part.name) if part.name in names else -1
        for guard in part.guards(rows, mode):
            guards.append(guard.row)
            exits.append(Exit(i, guard.mode, guard.resets, work))
    values = np.array(guards).reshape(len(guards), rows.size)
    flows, works = _forms(rows, scene)
    bounds = guard_bounds(values, rows.rates, scene.sample_time)
    guarded = np.concatenate([values, values @ rows.rates, bounds.scaled])
    return Mode(key, flows, works, guarded, bounds, exits, rows.storage)


def _forms(rows: Rows, scene: PlantModel) -> tuple[list[_Product], list[_Product]]:
    """Return the flows, and the works evaluated with the hand's deflection in the place of the position.

    In q and x_u the squares of a stiff hand would cancel: 1e6 N/m at 10 mm is 50 J, against the 0.1 J that flow.
    """
    shift = np.eye(rows.size)
    for name, factor in scene.deflection.items():
        shift[rows.index["position"], rows.index[name]] = factor
    back = 2.0 * np.eye(rows.size) - shift
    flows, _ = dyadic_flows(rows.rates, (), scene.sample_time)
    powers = [back.T @ power @ back for power in rows.powers]
    _, works = dyadic_flows(shift @ rows.rates @ back, powers, scene.sample_time)
    return [flow.dot for flow in flows], [matrix.copy().dot for matrix in _stacked(np.array(works), shift)]


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


def initial_state(scene: PlantModel) -> Array:
    """Return the state at the start, with torque 0."""
    state = np.zeros(len(scene.names))
    state[: len(scene.states)] = list(scene.states.values())
    state[-1] = 1.0
    return state


def first_key(scene: PlantModel) -> tuple[str, ...]:
    """Return the mode in which every part starts."""
    return tuple(part.modes[0] for part in scene.parts)
