"""The n-th operation on a log's file fails in its writer: the run ends or goes on as declared, and the log is kept.

A log that is not whole is named in the error, and what is in its file can be read or is refused.
"""

import errno
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from canhaptic.drive.safety.link_policy import StopReason
from canhaptic.errors import CanHapticError, LogFormatError, LogStoppedError
from canhaptic.logs.bus_reader import read_bus_log
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.logs.hdf5 import Dataset, Hdf5File
from tests.edges.short_run import Outcome, pressed

CYCLES = 1100
"""More than a chunk of rows, so that the writer works while the run goes on."""
PARENT = os.getpid()
ENERGY: dict[str, tuple[Any, str, int]] = {
    "append": (Dataset, "append", 120),
    "create": (Hdf5File, "create", 45),
    "flush": (Hdf5File, "flush", 4),
    "close": (Hdf5File, "close", 3),
    "replace": (os, "replace", 2),
    "open": (os, "open", 6),
}
"""What fails -> its owner, its name, and about how many calls a run has."""
BUS = {"write": (os, "write", 4), "fsync": (os, "fsync", 2), "open": (os, "open", 4), "truncate": (os, "truncate", 2)}


def cells(kinds: dict[str, tuple[Any, str, int]], fast: set[tuple[str, int]]) -> list[Any]:
    places = [(kind, n) for kind, (_, _, most) in kinds.items() for n in range(1, most + 1, 1 + most // 10)]
    return [pytest.param(*place, marks=() if place in fast else pytest.mark.slow) for place in places]


def fail_in_the_writer(patch: pytest.MonkeyPatch, owner: Any, name: str, n: int) -> None:
    """Let the n-th call fail in each process that is forked from this one."""
    call: Callable[..., Any] = getattr(owner, name)
    count = [0]

    def failing(*given: Any, **named: Any) -> Any:
        if os.getpid() != PARENT:
            count[0] += 1
            if count[0] == n:
                raise OSError(errno.ENOSPC, "No space left on device")
        return call(*given, **named)

    patch.setattr(owner, name, failing)


def run(log: str, path: Path) -> Outcome | None:
    """How the run ended; None where it was refused before anything was sent."""
    try:
        return pressed(at=10**9, cycles=CYCLES, **{log: path})  # type: ignore[arg-type]
    except CanHapticError as error:
        told = str(error)
    assert path.name in told
    return None


def require_told(seen: Outcome | None, path: Path) -> None:
    """Require that the drive is off, the account is there, and a log that is not whole is named."""
    if seen is None:
        return
    assert seen.edge.drive.torque == 0.0
    assert not seen.edge.drive.servo.is_powered
    assert seen.result["ports"]
    assert seen.reason is StopReason.OPERATOR  # as by the operator, also where the log ends the run
    if seen.error is not None:
        assert isinstance(seen.error, LogStoppedError)
        assert str(path) in str(seen.error)


@pytest.mark.slow_but("flush-1")
@pytest.mark.parametrize(("kind", "n"), cells(ENERGY, {("append", 14), ("flush", 1)}))
def test_an_energy_log_is_whole_or_said_not_to_be(kind: str, n: int, tmp_path, monkeypatch) -> None:
    owner, name, _ = ENERGY[kind]
    path = tmp_path / "run.h5"
    with monkeypatch.context() as patch:
        fail_in_the_writer(patch, owner, name, n)
        seen = run("energy_log", path)
    require_told(seen, path)
    assert n > 1 or seen is None or seen.error  # there is a first call of each
    if seen is None:
        return
    if seen.error is None:
        with EnergyLog.open(path) as log:
            assert (log.rows, log.status) == (seen.result["cycles"], "completed")
        return
    with suppress(LogFormatError), EnergyLog.open(path) as log:
        assert log.rows <= seen.result["cycles"]
        assert log.status not in ("complete", "completed", "running")


@pytest.mark.parametrize(("kind", "n"), cells(BUS, {("write", 1)}))
def test_a_bus_log_is_whole_or_said_not_to_be(kind: str, n: int, tmp_path, monkeypatch) -> None:
    owner, name, _ = BUS[kind]
    path = tmp_path / "run.log"
    with monkeypatch.context() as patch:
        fail_in_the_writer(patch, owner, name, n)
        seen = run("bus_log", path)
    require_told(seen, path)
    assert n > 1 or seen is None or seen.error
    if seen is not None and seen.error is None:
        syncs = sum(frame.can_id == 0x80 for frame in read_bus_log(path))
        assert syncs >= seen.result["cycles"]
