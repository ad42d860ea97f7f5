"""What is asked of the operating system: reported as granted or refused, given back, never a reason to fail."""

import ctypes
import gc
import os

import pytest

from canhaptic.drive.can.bus_cycle import can_buses
from canhaptic.drive.can.link import Link
from canhaptic.drive.can.servo_drive import ServoDrive
from canhaptic.drive.clock import WallClock
from canhaptic.drive.rig import Rig
from canhaptic.errors import StartError
from canhaptic.host.realtime import GRANTED, Realtime, RealtimeParameters
from tests.drive.drive_bench import MakeBench, axis, dictionary, started

Calls = list[tuple[object, ...]]
ROUND_ROBIN = 2  # SCHED_RR of sched.h


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> Calls:
    """Replaces the operating system by a list of what it was asked for; it grants everything."""
    made: Calls = []

    class System:
        def mlockall(self, flags: int) -> int:
            made.append(("mlockall", flags))
            return 0

        def munlockall(self) -> int:
            made.append(("munlockall",))
            return 0

    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    monkeypatch.setattr(os, "sched_setaffinity", lambda _, cpus: made.append(("cpus", *sorted(cpus))))
    monkeypatch.setattr(os, "sched_getscheduler", lambda _: ROUND_ROBIN)
    monkeypatch.setattr(os, "sched_getparam", lambda _: os.sched_param(3))
    monkeypatch.setattr(
        os, "sched_setscheduler", lambda _, policy, param: made.append(("policy", policy, param.sched_priority))
    )
    monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: System())
    monkeypatch.setattr(gc, "collect", lambda: made.append(("collect",)))
    monkeypatch.setattr(gc, "freeze", lambda: made.append(("freeze",)))
    monkeypatch.setattr(gc, "unfreeze", lambda: made.append(("unfreeze",)))
    return made


EVERYTHING = {"priority": 40, "cpus": (1,), "lock_memory": True, "freeze_garbage": True}
ASKED = [("cpus", 1), ("mlockall", 1), ("collect",), ("freeze",), ("policy", 0x40000001, 40)]
GIVEN_BACK = [("policy", ROUND_ROBIN, 3), ("unfreeze",), ("munlockall",), ("cpus", 0, 1)]


def test_nothing_is_asked_for_by_default(calls: Calls) -> None:
    realtime = Realtime(RealtimeParameters())
    realtime.begin()
    realtime.end()
    assert (calls, realtime.report) == ([], {})


def test_what_is_granted_is_given_back_in_reverse_and_once(calls: Calls) -> None:
    realtime = Realtime(RealtimeParameters(**EVERYTHING))
    realtime.begin()
    assert calls == ASKED
    assert realtime.report == dict.fromkeys(EVERYTHING, GRANTED)
    realtime.end()
    realtime.end()
    assert calls == ASKED + GIVEN_BACK


def test_a_refusal_is_reported_in_the_systems_words_and_leaves_nothing_to_give_back(calls: Calls, monkeypatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.setattr(ctypes, "get_errno", lambda: 12)
    monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: type("System", (), {"mlockall": lambda _self, _flags: -1})())
    realtime = Realtime(RealtimeParameters(**EVERYTHING))
    realtime.begin()
    assert realtime.report == {
        "cpus": "refused: this platform does not offer it",
        "lock_memory": "refused: [Errno 12] Cannot allocate memory",
        "freeze_garbage": GRANTED,
        "priority": "refused: [Errno 1] Operation not permitted",
    }
    realtime.end()
    assert calls == [("collect",), ("freeze",), ("unfreeze",)]


@pytest.mark.parametrize("ending", ["stop", "exception"])
def test_a_rig_asks_at_its_start_and_gives_back_at_every_end(bench: MakeBench, calls: Calls, ending: str) -> None:
    b = bench()
    b.rig.realtime = Realtime(RealtimeParameters(**EVERYTHING))
    b.rig.start()
    assert calls == ASKED
    assert b.rig.realtime.report["priority"] == GRANTED
    if ending == "stop":
        b.rig.stop()
    else:
        b.rig.sync()
        with pytest.raises(ValueError, match=r"torques for . axes"):
            b.rig.write_torques([])
    assert calls == ASKED + GIVEN_BACK


def test_a_start_that_fails_gives_back(bench: MakeBench, calls: Calls) -> None:
    b = bench(absent=True)
    b.rig.realtime = Realtime(RealtimeParameters(**EVERYTHING))
    with pytest.raises(StartError):
        b.rig.start()
    assert calls == ASKED + GIVEN_BACK


def test_only_a_rig_in_real_time_asks(bench: MakeBench, calls: Calls) -> None:
    b = started(bench, bus={"realtime": EVERYTHING})
    assert calls == []
    link = Link(b.buses[0], WallClock())
    drives = [ServoDrive(link, axis(), dictionary(axis()), b.rig.drives[0].bus)]
    Rig(can_buses(link, drives, b.rig.drives[0].bus), drives, b.rig.bus).realtime.begin()
    assert calls == ASKED
