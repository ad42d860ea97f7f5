"""One stiffness and one damping for every network that is designed for: the largest, with which all others change.

surface, path, coupled handles, virtual mass    its own `stiffness` and `damping`
anisotropic spring       the largest eigenvalues of both matrices, whose shapes stay; without a damping matrix the
                         damping has the shape of the stiffness
general                  the springs and forms that the ports move, and what dissipates at the ports or in parallel
                         with a spring; masses, inner springs and what is not linear stay as they are. Without such
                         a damper each of those springs gets one in proportion to its stiffness
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, cast

import numpy as np

from canhaptic.control.port_hamiltonian.dissipators import Damper, DampingMatrix, Dissipator
from canhaptic.control.port_hamiltonian.shapes.anisotropic_spring import AnisotropicSpring
from canhaptic.control.port_hamiltonian.shapes.general import General
from canhaptic.control.port_hamiltonian.storages import QuadraticForm, Spring, Storage, states_of
from canhaptic.errors import InputError
from canhaptic.units import Parameters

_Matrix = Sequence[Sequence[float]]


class NetworkScale(NamedTuple):
    """The parameter of a network that a design varies."""

    stiffness: float  # of the scene [N/m or N*m/rad]
    with_values: Callable[[float, float], Parameters]  # the network with another stiffness and damping


def network_scale(network: Parameters, name: str) -> NetworkScale:
    """Return the parameter of a network that a design varies.

    Args:
        network: Network of a scene.
        name: Its name in a scene.

    Raises:
        InputError: It has no spring at a port.
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
        return network.model_copy(
            update={"stiffness": _times(network.stiffness, stiffness / stiffest), "damping": damped}
        )

    return NetworkScale(stiffest, with_values)


def _general(network: General, name: str) -> NetworkScale:
    at_ports = _moved_by_ports(network)
    stiffest = max((_stiffness(storage) for _, storage in at_ports), default=0.0)
    if stiffest == 0.0:
        raise InputError(
            f"network {name!r} has no spring that a port moves, so no stiffness to design; its masses and inner "
            "springs are what the scene says"
        )
    most = max((_viscous(part) for part in network.dissipators), default=0.0)
    dissipators = network.dissipators if most else (*network.dissipators, *_in_proportion(network, at_ports))
    most = most or stiffest

    def with_values(stiffness: float, damping: float) -> Parameters:
        chosen = {place for place, _ in at_ports}
        storages = [
            _stiffened(storage, stiffness / stiffest) if place in chosen else storage
            for place, storage in enumerate(network.storages)
        ]
        damped = tuple(_damped(part, damping / most) for part in dissipators)
        return network.model_copy(update={"storages": tuple(storages), "dissipators": damped})

    return NetworkScale(stiffest, with_values)


def _moved_by_ports(network: General) -> list[tuple[int, Storage]]:
    """Return the springs and forms that a port moves, each with its place among the storages."""
    found: list[tuple[int, Storage]] = []
    state = 0
    for place, storage in enumerate(network.storages):
        rows = network.gain[state : state + states_of(storage)]
        if isinstance(storage, Spring | QuadraticForm) and any(value != 0.0 for row in rows for value in row):
            found.append((place, storage))
        state += states_of(storage)
    return found


def _in_proportion(network: General, at_ports: Sequence[tuple[int, Storage]]) -> list[Dissipator]:
    """Return a damper in parallel with each spring that a port moves, as large in number as its stiffness."""
    found: list[Dissipator] = []
    starts = np.cumsum([0, *(states_of(storage) for storage in network.storages)]).tolist()
    for place, storage in at_ports:
        state = starts[place]
        if isinstance(storage, Spring):
            found.append(Damper(type="damper", viscous=storage.stiffness, beside=state))
        elif isinstance(storage, QuadraticForm):
            gain = np.array(network.gain[state : state + states_of(storage)])
            matrix = gain.T @ np.array(storage.matrix) @ gain
            ports = tuple(range(gain.shape[1]))
            found.append(DampingMatrix(type="damping_matrix", matrix=_times(matrix.tolist(), 1.0), ports=ports))
    return found


def _stiffness(storage: Storage) -> float:
    if isinstance(storage, QuadraticForm):
        return _largest(storage.matrix)
    return storage.stiffness if isinstance(storage, Spring) else 0.0


def _stiffened(storage: Storage, factor: float) -> Storage:
    if isinstance(storage, QuadraticForm):
        return storage.model_copy(update={"matrix": _times(storage.matrix, factor)})
    return storage.model_copy(update={"stiffness": cast(Spring, storage).stiffness * factor})


def _viscous(part: Dissipator) -> float:
    """Return the largest linear coefficient of what dissipates at the ports or in parallel with a spring."""
    if isinstance(part, DampingMatrix):
        return _largest(part.matrix) if part.ports else 0.0
    return 0.0 if part.states else part.viscous


def _damped(part: Dissipator, factor: float) -> Dissipator:
    if not _viscous(part):
        return part
    if isinstance(part, DampingMatrix):
        return part.model_copy(update={"matrix": _times(part.matrix, factor)})
    return part.model_copy(update={"viscous": part.viscous * factor})


def _largest(matrix: _Matrix) -> float:
    """Return the largest eigenvalue of a symmetric matrix that is positive semidefinite."""
    return max(0.0, float(np.linalg.eigvalsh(np.array(matrix))[-1]))


def _times(matrix: _Matrix, factor: float) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(factor * value for value in row) for row in matrix)
