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
    first: float
    second: float
    third: float


def only_late(late: float) -> float:
    return late.no_number_has_this  # type: ignore[attr-defined]  # cannot be compiled


def step(whole: Whole, value: float) -> float:
    settings, inner, _, value = whole.run.settings, whole.run.settings.inner, 0.0, value
    if settings.losses == 0 and inner.late == 0.0 and not settings.exists:
        return inner.gain * value + inner.late + settings.losses + settings.offset
    return only_late(inner.late)


def step_of_parts(whole: Whole, value: float) -> float:
    run, _, _, _ = whole
    settings = run.settings
    if settings.losses > 0:
        return only_late(settings.inner.late)
    return step(whole, value)


def steps(rows: Records, found: Any) -> None:
    for i in range(len(rows)):
        found[i] = step_of_parts(Whole(Run(rows[i], None, None), 0.0, 0.0, 0.0), 3.0)


def run(*settings: Settings) -> list[float]:
    found = np.zeros(len(settings))
    compiled(steps)(records_of(settings), found)
    return found.tolist()


def test_a_record_says_which_numbers_are_zero_in_all_scenes() -> None:
    settings = [Settings(Inner(), offset=1.0), Settings(Inner(), losses=2)]
    rows = records_of(settings)
    assert rows.dtype.names == ("inner", "losses", "exists", "exists = False", "offset")
    assert rows.dtype["inner"].names == ("late", "late = 0.0", "gain")
    assert records_of(settings, plain=True).dtype.names == ("inner", "losses", "exists", "offset")
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


def read_by_a_changing_name(rows: Records, found: Any) -> None:
    settings = rows[0]
    for i in range(len(rows)):
        settings = rows[i]
        found[i] = settings.losses + settings.inner.late + settings.offset


@pytest.mark.slow
def test_a_zero_that_cannot_be_traced_is_read_from_the_record() -> None:
    rows, found = records_of([Settings(Inner(), offset=1.0), Settings(Inner(), offset=2.0)]), np.zeros(2)
    compiled(read_by_a_changing_name)(rows, found)
    assert found.tolist() == [1.0, 2.0]
