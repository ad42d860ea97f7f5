"""Linear transmissions, and the distance from a path, by numbers worked out by hand."""

from math import sqrt

import pytest

from canhaptic.control.mechanisms.transmission import Transmission
from canhaptic.control.port_hamiltonian.shapes.guided_path import GuidedPath, path_through
from canhaptic.control.port_hamiltonian.shapes.sphere import Sphere
from canhaptic.control.port_hamiltonian.shapes.virtual_mass import MassOnSpring
from canhaptic.errors import ParameterError


def test_a_transmission_takes_any_regular_matrix_however_unlike_its_rows() -> None:
    for matrix in (((1.0, 0.0), (0.0, 1.0)), ((1.0, 0.5), (0.0, -2e-3)), ((0.1, 0.2, 0.3),)):
        assert Transmission(matrix=matrix).axes == len(matrix[0])


@pytest.mark.parametrize(
    ("matrix", "words"),
    [
        (((1.0, 0.0), (0.0,)), "equal length"),
        (((1.0,), (0.0, 1.0)), "equal length"),
        (((), ()), "equal length"),
        (((1.0,), (2.0,)), "2 task coordinates for 1 motor axes"),
        (((1.0, 2.0), (2.0, 4.0)), "singular"),
        (((1.0, 0.0), (0.0, 1e-7)), "singular"),
    ],
)
def test_a_matrix_that_loses_a_direction_or_is_none_is_refused(
    matrix: tuple[tuple[float, ...], ...], words: str
) -> None:
    with pytest.raises(ParameterError, match=words):
        Transmission(matrix=matrix)


@pytest.mark.parametrize(
    ("position", "distance", "direction"),
    [
        ((1.0, 0.5), 0.5, (0.0, 1.0)),  # next to the first piece
        ((-3.0, 4.0), 5.0, (-0.6, 0.8)),  # before the begin
        ((2.5, 1.0), 0.5, (1.0, 0.0)),  # next to the last piece
        ((3.0, 3.0), sqrt(2.0), (sqrt(0.5), sqrt(0.5))),  # beyond the end
        ((2.0, 1.5), 0.0, (0.0, 0.0)),  # on it
    ],
)
def test_the_distance_from_a_path_is_that_from_its_nearest_place(
    position: tuple[float, float], distance: float, direction: tuple[float, float]
) -> None:
    values, rows = [0.0], [[0.0, 0.0]]
    path_through([(0.0, 0.0), (2.0, 0.0), (2.0, 2.0)]).measure(list(position), values, rows)
    assert values[0] == pytest.approx(distance)
    assert rows[0] == pytest.approx(direction)


def test_a_path_has_points_of_as_many_coordinates() -> None:
    assert GuidedPath(points=((0.0, 0.0), (1.0, 0.0)), stiffness=100.0).points[1] == (1.0, 0.0)
    for points in (((0.0, 0.0),), ((0.0, 0.0), (1.0,)), ((0.0, 0.0), (1.0, 0.0, 0.0))):
        with pytest.raises(ParameterError, match="at least 2 with equally many coordinates"):
            GuidedPath(points=points, stiffness=100.0)


@pytest.mark.parametrize(("side", "sign"), [("outside", 1.0), ("inside", -1.0)])
def test_a_sphere_is_free_on_its_side(side: str, sign: float) -> None:
    sphere = Sphere(centre=(0.1, 0.0), radius=0.05, side=side, stiffness=100.0)
    values, rows = [0.0], [[0.0, 0.0]]
    sphere.build(2).geometry.measure([0.2, 0.0], values, rows)
    assert values[0] == pytest.approx(sign * 0.05)
    assert rows[0] == pytest.approx([sign, 0.0])


def test_a_mass_on_a_spring_needs_a_place() -> None:
    with pytest.raises(ParameterError, match="anchor: got no coordinates"):
        MassOnSpring(mass=1.0, stiffness=100.0, anchor=(), anchor_stiffness=50.0)
