"""A kernel with a placeholder filled, in Python; the old forms of the algorithms judge the numbers."""

import pytest

from canhaptic.errors import ParameterError
from canhaptic.kernels.records import bound, filled


def respond(depth: float) -> float:
    raise NotImplementedError


def step(depth: float) -> float:
    return respond(depth) + 1.0


def spring(depth: float) -> float:
    return stiffness_of(depth) * depth


pulled = filled(step, respond=spring)


def stiffness_of(depth: float) -> float:
    """Comes after the kernel was filled, as a helper below the class of somebody's own algorithm may."""
    return 5.0 if depth > 0.0 else 0.0


def test_a_filled_kernel_calls_what_is_in_the_place_and_leaves_the_first_one_alone() -> None:
    assert (pulled(2.0), pulled(-2.0)) == (11.0, 1.0)
    assert filled(step, respond=abs)(-2.0) == 3.0
    assert step.__globals__["respond"] is respond


def test_a_filled_kernel_is_bound_anew_as_any_other() -> None:
    def soft(depth: float) -> float:
        return 1.0

    assert bound(pulled, {stiffness_of: soft})(2.0) == 3.0


def test_a_function_of_other_arguments_is_refused_where_it_is_put() -> None:
    with pytest.raises(ParameterError, match=r"^two: takes 2 arguments in place of respond, expected 1: \("):
        filled(step, respond=two)


def two(first: float, second: float) -> float:
    return first + second
