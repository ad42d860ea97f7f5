"""The equation of a network compiled by numba; needs the extra `fast`. The source is that of `njit_registry`.

Compiling takes some seconds, once in a process. Only the equation is compiled, not the account of the group.
"""

from collections.abc import Callable
from functools import cache
from types import FunctionType
from typing import Any

import numba
import numpy as np

from canhaptic.control.port_hamiltonian.discrete_gradient import NetworkTables
from canhaptic.control.port_hamiltonian.equation import Workspace
from canhaptic.control.port_hamiltonian.njit_registry import MODULES, plain_functions


@cache
def _compiled_advance() -> Callable[..., int]:
    """Returns `step.advance`, compiled at its first call."""
    names = {name: value for module in MODULES for name, value in vars(module).items()}
    for function in plain_functions():
        rebound = FunctionType(function.__code__, names, function.__name__, function.__defaults__)
        names[function.__name__] = numba.njit(rebound)
    advance: Callable[..., int] = names["advance"]
    return advance


class CompiledEquation:
    """The equation of one network over arrays of its own, with lists on the outside."""

    def __init__(self, network: NetworkTables, room: Workspace) -> None:
        """Takes a network as data.

        Args:
            network: Its structure may change later; everything else stays.
            room: Lists that receive what a step finds.
        """
        self._advance, self._lists, self._structure = _compiled_advance(), room, network.structure
        self._tables = NetworkTables(*[_array(value) for value in network])
        self._room = Workspace(*[_array(value) for value in room])
        n, ports = len(network.stiffness), len(network.gain[0])
        self._state, self._displacement = np.zeros(n), np.zeros(ports)
        if not network.viscous:
            self._tables = self._tables._replace(
                on_states=np.zeros((0, n)), on_ports=np.zeros((0, ports)), beside=_array([-1])[:0]
            )

    def advance(self, state: Any, displacement: Any, sample_time: float, changed: bool) -> int:
        """Finds the state change of one sample; see `step.advance`.

        Args:
            state: x, (states,).
            displacement: Of the ports [m or rad], (ports,).
            sample_time: [s].
            changed: Whether the structure is another one than before.
        """
        room, lists = self._room, self._lists
        if changed:
            self._tables.structure[:] = self._structure
        self._state[:] = state
        self._displacement[:] = displacement
        room.step[:] = lists.step
        found: int = self._advance(self._tables, self._state, self._displacement, sample_time, room, None)
        lists.step[:] = room.step.tolist()
        lists.efforts[:] = room.efforts.tolist()
        lists.flows[:] = room.flows.tolist()
        lists.losses[:] = room.losses.tolist()
        lists.engaged[:] = room.engaged.tolist()
        lists.driven[:] = room.driven.tolist()
        return found


def _array(value: Any) -> Any:
    """Returns a list as an array, anything else as it is."""
    if not isinstance(value, list):
        return value
    integers = bool(value) and all(isinstance(v, int) and not isinstance(v, bool) for v in value)
    return np.array(value, dtype=np.int64 if integers else np.float64)
