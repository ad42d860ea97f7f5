"""Traps of the libraries that no other test has as its subject (docs/how_it_works.md has all), and any bytes."""

import ast
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import can
import canopen
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canhaptic.cycle import run
from canhaptic.drive.axis_parameters import CanBusParameters
from canhaptic.drive.can.door import open_bus
from canhaptic.errors import CanHapticError
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from canhaptic.sim.drive.profile.state_machine import DriveState
from tests.drawn import examples
from tests.drive.drive_bench import REPOSITORY, Bench, MakeBench, axis, make_bench, started

TRAITS = REPOSITORY / "tests" / "sim_drive" / "eds"


@contextmanager
def running_bench() -> Iterator[Bench]:
    b = make_bench()
    try:
        b.rig.start()
        b.run(5, torque=1.0)
        yield b
    finally:
        b.close()


def test_an_rpdo_given_back_is_sent_on_every_cycle_all_the_same() -> None:
    """canopen takes its own RPDO, given back twice, for one that a periodic producer sends."""
    theirs = canopen.RemoteNode(5, canopen.ObjectDictionary()).rpdo
    rpdo = canopen.pdo.base.PdoMap(theirs, None, None)
    rpdo.cob_id = 0x205
    assert not rpdo.is_periodic
    for time in (0.001, 0.002):
        rpdo.on_message(0x205, bytearray(4), time)
    assert rpdo.is_periodic

    scene = load_scene(REPOSITORY / "configs" / "demo.yaml", ["bus.options={receive_own_messages: true}"])
    with build(scene) as experiment:
        run(experiment.cycle, 50)
        statistics = experiment.rig.drives[0].link.statistics
        assert statistics.echoed == statistics.sent > 150


def test_a_mapping_declared_as_array_gets_its_entries_written(bench: MakeBench) -> None:
    """canopen's save() writes no entries there and switches the PDO on all the same."""
    b = started(bench, [axis(eds=TRAITS / "array_maps.eds")])
    written = [data[4:].hex() for data in b.sent(0x605) if data[0] == 0x23 and data[1:3] in (b"\x00\x16", b"\x00\x1a")]
    assert {"10004060", "10007160", "10004160", "20006460"} <= set(written)
    assert b.run(5, torque=1.0)[-1].torque_applied == pytest.approx(1.0)


def test_fixed_maps_are_never_written(bench: MakeBench) -> None:
    b = started(bench, [axis(eds=TRAITS / "fixed_maps.eds")])
    fixed = [
        plan.mapping_index for plan in (b.rig.drives[0].map.rpdo, *b.rig.drives[0].map.tpdos) if not plan.is_written
    ]
    assert fixed
    writes = [int.from_bytes(data[1:3], "little") for data in b.sent(0x605) if data[0] in (0x23, 0x27, 0x2B, 0x2F)]
    assert not set(fixed) & set(writes)
    assert b.run(5, torque=1.0)[-1].fresh


def test_a_drive_that_never_indicates_the_size_of_an_answer_is_brought_up(bench: MakeBench) -> None:
    b = started(bench, drive_values={"sdo_size_indicated": False})
    assert b.drives[0].state is DriveState.OPERATION_ENABLED


def test_a_drive_in_nmt_stopped_is_brought_up(bench: MakeBench) -> None:
    b = bench()
    b.drives[0].wake(0)
    b.buses[0].send(can.Message(arbitration_id=0x000, is_extended_id=False, data=b"\x02\x05"))
    b.rig.start()
    assert b.drives[0].state is DriveState.OPERATION_ENABLED


def test_no_pdo_but_the_chosen_ones_stays_switched_on(bench: MakeBench) -> None:
    b = started(bench, objects={"0x1801.1": 0x285, "0x1402.1": 0x405})
    for index in (0x1401, 0x1402, 0x1403, 0x1801, 0x1802, 0x1803):
        assert b.rig.drives[0].sdo.read(index, 1) & 0x80000000


def test_a_lost_sdo_answer_does_not_end_the_start(bench: MakeBench) -> None:
    b = bench()
    lost: list[can.Message] = []

    def lose_every_tenth(message: can.Message) -> can.Message | None:
        if message.arbitration_id == 0x585:
            lost.append(message)
            if len(lost) % 10 == 0:
                return None
        return message

    b.tampered.on_receive = lose_every_tenth
    b.rig.start()
    assert len(lost) > 20
    assert b.drives[0].state is DriveState.OPERATION_ENABLED


def test_an_sdo_inside_a_handler_is_answered_at_once(bench: MakeBench) -> None:
    """In a callback of canopen it blocks for 0.3 s: the thread that would take the answer is the one that waits."""
    b = started(bench)
    found: list[tuple[int, int]] = []

    def read(_: bytearray) -> None:
        begin = b.clock.now()
        found.append((b.rig.drives[0].sdo.read(0x6502), b.clock.now() - begin))

    b.links[0].subscribe(0x3AB, read)
    b.buses[1].send(can.Message(arbitration_id=0x3AB, is_extended_id=False))
    b.links[0].drain()
    assert found == [(0x3FF, 0)]


def test_a_whole_run_starts_no_thread_that_would_have_to_be_awaited(bench: MakeBench) -> None:
    """canopen's disconnect takes a second, in which python-can's Notifier wakes up from its last wait."""
    before = set(threading.enumerate())
    b = started(bench)
    b.run(5)
    assert set(threading.enumerate()) == before
    b.rig.stop()
    assert set(threading.enumerate()) == before


def test_nothing_of_canopen_that_reads_or_writes_by_itself_is_used() -> None:
    """Its Network, nodes, PDOs, p402 and DCF writer: of canopen the package has the dictionary and the abort codes."""
    names = set()
    texts = [path.read_text() for path in (REPOSITORY / "canhaptic").rglob("*.py")]
    for text in (text for text in texts if "canopen" in text.replace("canhaptic.canopen", "")):
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "canopen":
                names |= {f"{node.module}.{alias.name}" for alias in node.names}
            elif isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names if alias.name.split(".")[0] == "canopen"}
    allowed = ("canopen.ObjectDictionary", "canopen.objectdictionary.", "canopen.sdo.exceptions.")
    others = {name for name in names if not name.startswith(allowed)}
    assert others == set()
    assert not {name for name in names if "export" in name or "import_" in name}


def test_a_connection_that_nobody_reads_blocks_nobody() -> None:
    with (
        open_bus(CanBusParameters(rate=1000.0), "unread") as bus,
        open_bus(CanBusParameters(rate=1000.0), "unread") as other,
    ):
        for number in range(20_000):
            other.send(can.Message(arbitration_id=0x181, is_extended_id=False, data=number.to_bytes(4, "little")))
        received = [bus.recv(0.0) for _ in range(20_000)]
    assert all(message is not None for message in received)


IDENTIFIERS = st.sampled_from([0x000, 0x080, 0x085, 0x185, 0x205, 0x285, 0x585, 0x605, 0x705, 0x77E, 0x123])
FRAMES = st.lists(st.tuples(IDENTIFIERS, st.binary(max_size=8)), min_size=1, max_size=8)


@settings(max_examples=examples(60))
@given(FRAMES)
def test_arbitrary_frames_in_the_cycle_never_give_torque_beyond_the_limit_or_an_unknown_error(frames):
    with running_bench() as b:
        try:
            for can_id, data in frames:
                b.buses[1].send(can.Message(arbitration_id=can_id, is_extended_id=False, data=data))
                b.run(1, torque=1.0)
        except CanHapticError:
            assert b.drives[0].torque == 0.0
            assert b.drives[0].state is not DriveState.OPERATION_ENABLED
        assert all(abs(torque) <= 800 for torque in b.torques_sent())


@settings(max_examples=examples(40))
@given(st.integers(0, 60), st.sampled_from([0x585, 0x705, 0x185]), st.binary(max_size=8))
def test_an_arbitrary_answer_anywhere_in_the_start_never_ends_in_torque_or_an_unknown_error(which, can_id, data: bytes):
    b = make_bench()
    seen: list[can.Message] = []

    def corrupt(message: can.Message) -> can.Message:
        if message.arbitration_id == can_id:
            seen.append(message)
            if len(seen) == which:
                message.data, message.dlc = bytearray(data), len(data)
        return message

    b.tampered.on_receive = corrupt
    try:
        b.rig.start()
        b.run(2)
    except CanHapticError:
        assert b.drives[0].state is not DriveState.OPERATION_ENABLED
    finally:
        b.close()
    assert set(b.torques_sent()) <= {0}
