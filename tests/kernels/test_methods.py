"""A compiled kernel calls the methods of the NamedTuples that it gets; compiling it takes half a second."""

from typing import Any, NamedTuple

import pytest

from canhaptic.errors import InputError
from canhaptic.kernels import new


class Spring(NamedTuple):
    stiffness: float

    def effort(self, state: float) -> float:
        return self.stiffness * state


def pull(spring: Spring, state: float) -> float:
    return new(Spring, (spring.effort(state) + 1.0,)).stiffness


@pytest.mark.slow
@pytest.mark.timeout(300)  # half a second of compiling, longer on a busy machine
def test_a_compiled_kernel_calls_the_method_of_a_named_tuple() -> None:
    pytest.importorskip("numba", reason="needs numba (the extra fast)")
    from canhaptic.kernels.compiler import _PROCESS, compiled

    run: Any = compiled(pull)
    assert run(Spring(2.0), 3.0) == pull(Spring(2.0), 3.0) == 7.0
    [made] = run.overloads.values()
    reached = [one.name for one in made.library._linking_libraries if one.name != "nrt"]  # which is numba's own
    assert len(reached) == 3
    assert all(name.endswith(_PROCESS) for name in reached)  # else kept code could call another method of this name


class Touch(NamedTuple):
    contact: bool
    depth: float


def touch(depth: float) -> Touch:
    return Touch(depth > 0.0, depth)


def test_a_field_with_the_name_of_a_method_is_refused() -> None:
    pytest.importorskip("numba", reason="needs numba (the extra fast)")
    from canhaptic.kernels.compiler import compiled

    with pytest.raises(InputError, match="Touch: got a field 'contact', expected a name that is not a method"):
        compiled(touch)
