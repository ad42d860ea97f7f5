"""A simulated drive alone on a bus."""

from collections.abc import Iterator

import pytest

from tests.sim_drive.drive_on_bus import Rig


@pytest.fixture
def rig() -> Iterator[Rig]:
    with Rig() as rig:
        yield rig
