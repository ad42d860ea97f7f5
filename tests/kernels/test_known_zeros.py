"""A number that is 0 in all scenes is a constant of their compiled loop, and what needs another value is left out."""

from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np
import pytest

pytest.importorskip("numba")

from numba.core.errors import NumbaError

from canhaptic.kernels import OFTEN_ZERO, Run
from canhaptic.kernels.compiler import compiled
from canhaptic.kernels.records import Records, records_of


@dataclass(frozen=True, slots=True)
class Inner:
    late: Annotated[float, OFTEN_ZERO] = 0.0
    gain: float = 2.0


@dataclass(frozen=True, slots=True)
class Settings:
    inner: Inner
    losses: Annotated[int, OFTEN_ZERO] = 0
    exists: Annotated[bool, OFTEN_ZERO] = False
    offset: float = 0.0


class Whole(NamedTuple):
    run: Run[Settings, None, None]


def only_late(late: float) -> float:
    return late.no_number_has_this  # type: ignore[attr-defined]  # cannot be compiled


def step(whole: Whole, value: float) -> float:
    settings, inner, _, value = whole.run.settings, whole.run.settings.inner, 0.0, value
    if settings.losses == 0 and inner.late == 0.0 and not settings.exists:
        return inner.gain * value + inner.late + settings.losses + settings.offset
    return only_late(inner.late)


def steps(rows: Records, found: Any) -> None:
    for i in range(len(rows)):
        found[i] = step(Whole(Run(rows[i], None, None)), 3.0)


def run(*settings: Settings) -> list[float]:
    found = np.zeros(len(settings))
    compiled(steps)(records_of(settings), found)
    return found.tolist()


def test_a_number_that_is_zero_in_all_scenes_is_left_out_of_their_records() -> None:
    rows = records_of([Settings(Inner(), offset=1.0), Settings(Inner(), losses=2)])
    assert rows.dtype.names == ("inner", "losses", "exists = False", "offset")
    assert rows.dtype["inner"].names == ("late = 0.0", "gain")
    assert rows["losses"].tolist() == [0, 2]
    assert rows["offset"].tolist() == [1.0, 0.0]  # not marked
    assert rows["inner"]["gain"].tolist() == [2.0, 2.0]


@pytest.mark.slow
def test_a_branch_that_no_scene_takes_is_not_compiled() -> None:
    assert run(Settings(Inner(), offset=1.0), Settings(Inner(gain=5.0))) == [7.0, 15.0]


@pytest.mark.slow
@pytest.mark.parametrize(
    "other", [Settings(Inner(late=1.0)), Settings(Inner(), losses=1), Settings(Inner(), exists=True)]
)
def test_one_scene_that_needs_the_branch_has_it_compiled_for_all(other: Settings) -> None:
    with pytest.raises(NumbaError, match="no_number_has_this"):
        run(Settings(Inner()), other)


@pytest.mark.slow
def test_numbas_own_steps_know_the_zeros_as_well(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("canhaptic.kernels.linking._installed", lambda: False)  # an unknown version of numba
    assert run(Settings(Inner(), offset=1.0)) == [7.0]
