"""A compiled kernel calls the methods of the NamedTuples that it gets; compiling it takes half a second."""

from typing import NamedTuple

import pytest


class Spring(NamedTuple):
    stiffness: float

    def effort(self, state: float) -> float:
        return self.stiffness * state


def pull(spring: Spring, state: float) -> float:
    return spring.effort(state) + 1.0


@pytest.mark.slow
@pytest.mark.timeout(300)  # half a second of compiling, longer on a busy machine
def test_a_compiled_kernel_calls_the_method_of_a_named_tuple() -> None:
    pytest.importorskip("numba", reason="needs numba (the extra fast)")
    from canhaptic.kernels.compiler import compiled

    assert compiled(pull)(Spring(2.0), 3.0) == pull(Spring(2.0), 3.0) == 7.0
