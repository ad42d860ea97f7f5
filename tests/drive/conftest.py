"""A bench that closes its buses."""

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from tests.drive.drive_bench import Bench, make_bench


@pytest.fixture
def bench() -> Iterator[Callable[..., Bench]]:
    """Makes benches (see `make_bench`) and closes them at the end of the test."""
    made: list[Bench] = []

    def make(*arguments: Any, **values: Any) -> Bench:
        made.append(make_bench(*arguments, **values))
        return made[-1]

    yield make
    for one in made:
        one.close()
