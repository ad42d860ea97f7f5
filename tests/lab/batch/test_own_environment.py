"""An environment of one's own runs in a batch: compiled where numba can, else one by one with the reason."""

from typing import Annotated, Any, ClassVar

import numpy as np
import pytest

from canhaptic.lab.batch.cases import NotBatchableError
from canhaptic.lab.batch.marching import march
from canhaptic.lab.figures.figures import METRICS
from canhaptic.units import Parameters, quantity
from tests.lab.batch.loops import PLANT, USER
from tools.bench.standard_cases import loop_in_arrays, standard_case


class CenteringSpring(Parameters):
    """A spring from both sides, with a property and a helper of its own."""

    stiffness: Annotated[float, quantity("N/m")]
    damping: Annotated[float, quantity("N*s/m")] = 0.0
    centre: Annotated[float, quantity("m")] = 0.0

    relaxes: ClassVar[bool] = False

    @property
    def linear_stiffness(self) -> float:
        return self.stiffness

    def contact(self, position: float) -> int:
        return 1

    def true_state(self, position: float, displacement: float, previous: float) -> float:
        return position - self.centre

    def admissible(self, state: float, true: float) -> float:
        return state

    def stored_energy(self, state: float) -> float:
        return 0.5 * self.stiffness * state * state

    def effort(self, state: float) -> float:
        return self.stiffness * state

    def state_of_energy(self, energy: float, like: float) -> float:
        return float(np.copysign(np.sqrt(2.0 * energy / self.stiffness), like))

    def relaxed(self, state: float, sample_time: float) -> float:
        return state


class Talking(CenteringSpring):
    """One whose effort numba cannot compile."""

    def effort(self, state: float) -> float:
        return float({"effort": self.stiffness * state}.get("effort", "no"))


def batch(kind: Any, scenes: int) -> Any:
    """Returns a batch of scenes that differ in the stiffness."""
    case = standard_case(kind(stiffness=100.0, damping=2.0), "unprotected", 1000.0, USER, plant=PLANT, delay=1)
    return loop_in_arrays(case, PLANT, USER, {"environment.stiffness": np.linspace(50.0, 500.0, scenes)})


@pytest.mark.slow
def test_an_environment_of_ones_own_is_compiled() -> None:
    pytest.importorskip("numba")
    case = batch(CenteringSpring, 3)
    first, second = (march(case, 3, 100, engine, list(METRICS)) for engine in ("python", "numba"))
    for name in METRICS:
        np.testing.assert_array_equal(first[name], second[name], err_msg=name)
    assert len(set(first["torque_peak"].tolist())) == 3


@pytest.mark.slow
def test_one_that_numba_cannot_compile_says_so_and_runs_in_python() -> None:
    pytest.importorskip("numba")
    case = batch(Talking, 2)
    assert np.isfinite(march(case, 2, 20, "python", ["torque_peak"])["torque_peak"]).all()
    with pytest.raises(NotBatchableError, match="numba cannot compile Talking"):
        march(case, 2, 20, "numba", ["torque_peak"])
