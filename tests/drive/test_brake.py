"""An axis that hangs does not sink: its brake holds before the torque goes, and opens before a torque counts."""

from pathlib import Path
from typing import Any

import pytest

from canhaptic.canopen.attached_devices import Brake
from canhaptic.canopen.objects import DataType
from canhaptic.errors import DictionaryError, StartError
from canhaptic.sim.drive.profile.state_machine import DriveState
from tests.drive.drive_bench import OUR_EDS, Bench, FreeMass, MakeBench, axis, started

WEIGHT = 5.0  # [N] of 1 kg in a field of 5 N/kg, so that 8 N hold it
TIMES = {"release_time": 0.03, "set_time": 0.05, "holds_weight": WEIGHT}


class HungMass(FreeMass):
    """A mass of 1 kg with a weight, which sinks without a torque."""

    def advance_to(self, now: int, torque: float) -> None:
        super().advance_to(now, torque - WEIGHT)


def with_outputs(folder: Path, access: str = "rw") -> Path:
    path = folder / "outputs.eds"
    text = OUR_EDS.read_text(encoding="utf-8") + "\n[60FE]\nParameterName=Outputs\nObjectType=0x8\nSubNumber=3\n"
    for sub, kind, right in ((0, "0x0005", "ro"), (1, "0x0007", access), (2, "0x0007", access)):
        text += f"[60FEsub{sub}]\nParameterName=Part {sub}\nObjectType=0x7\nDataType={kind}\nAccessType={right}\n"
        text += f"DefaultValue={2 if sub == 0 else 0}\nPDOMapping=0\n"
    path.write_text(text, encoding="utf-8")
    return path


def hung(bench: MakeBench, brake: Brake | None, outputs: int | None = None, **values: Any) -> Bench:
    objects = None if outputs is None else {"0x60FE.1": outputs}
    b = bench([axis(brake=brake, **values)], objects=objects, drive_values={"brake": brake})
    servo = b.drives[0].servo
    servo.motor = HungMass()
    if servo._brake is None:
        servo._mover = servo.motor
    else:
        servo._brake._motor = servo.motor
    return b


def brakes(folder: Path) -> list[tuple[Brake | None, dict[str, Any]]]:
    return [
        (Brake(**TIMES), {}),
        (Brake(by="host", output=16, **TIMES), {"eds": with_outputs(folder)}),
    ]


@pytest.mark.parametrize("by", [0, 1], ids=["by the drive", "by the host"])
def test_a_hung_axis_sinks_neither_at_the_start_nor_at_the_stop(bench: MakeBench, tmp_path: Path, by: int) -> None:
    brake, values = brakes(tmp_path)[by]
    b = hung(bench, brake, **values)
    b.rig.start()
    begun = b.drives[0].servo.motor.position
    assert begun == pytest.approx(0.01, abs=2e-5)  # [m] not more than in one or two sample times after it opened
    b.run(300, WEIGHT)
    before = b.drives[0].servo.motor.position
    b.rig.stop()
    b.links[0].pump(b.clock.now() + 1_000_000_000)
    b.drives[0].servo.sample()
    assert b.drives[0].servo.motor.position == pytest.approx(before, abs=1e-3)  # its speed goes on until it is held
    assert b.drives[0].state is DriveState.SWITCH_ON_DISABLED
    assert b.torques_sent()[-1] == 0
    assert b.rig.drives[0].unrestored[1:] == []


def test_without_a_brake_it_sinks(bench: MakeBench) -> None:
    b = hung(bench, None)
    b.rig.start()
    b.run(300, WEIGHT)
    before = b.drives[0].servo.motor.position
    b.rig.stop()
    b.drives[0].servo.now = b.clock.now() + 1_000_000_000
    b.drives[0].servo.sample()
    assert b.drives[0].servo.motor.position < before - 1.0


def test_no_torque_of_the_controller_counts_before_the_brake_is_open(bench: MakeBench) -> None:
    b = hung(bench, Brake(**TIMES))
    b.rig.start()
    enabled = next(time for time, can_id, data, is_rx in b.frames if can_id == 0x185 and data[0] & 0x6F == 0x27)
    assert b.clock.now() - enabled >= 30_000_000
    assert set(b.torques_sent()) == {0}


def test_the_declared_weight_and_not_the_last_torque_is_kept_until_the_brake_holds(bench: MakeBench, tmp_path) -> None:
    b = hung(bench, Brake(by="host", output=16, **TIMES), eds=with_outputs(tmp_path))
    b.rig.start()
    b.run(100, WEIGHT)
    b.run(1, 8.0)
    begin = len(b.frames)
    b.rig.stop()
    sent = [(time, can_id, data) for time, can_id, data, is_rx in b.frames[begin:] if not is_rx]
    set_at = next(time for time, can_id, data in sent if can_id == 0x605 and data.hex().startswith("23fe6001"))
    kept = [time for time, can_id, data in sent if can_id == 0x205 and data[2:4] == b"\xf4\x01"]  # 500 per mille
    assert kept[-1] - set_at >= 50_000_000
    assert {data[2:4] for _, can_id, data in sent if can_id == 0x205} == {b"\xf4\x01", b"\0\0"}


def test_a_fault_takes_the_torque_at_once_and_sets_the_brake(bench: MakeBench, tmp_path: Path) -> None:
    b = hung(bench, Brake(by="host", output=16, **TIMES), eds=with_outputs(tmp_path))
    b.rig.start()
    b.run(100, WEIGHT)
    begin = len(b.frames)
    b.rig.stop(ramp=False)
    sent = [(can_id, data.hex()) for _, can_id, data, is_rx in b.frames[begin:] if not is_rx]
    assert sent[0][0] == 0x205
    assert sent[0][1].endswith("0000")
    assert (0x605, "23fe600100000000") in sent


def test_outputs_that_cannot_be_written_are_refused(bench: MakeBench, tmp_path: Path) -> None:
    with pytest.raises(DictionaryError, match="0x60fe:01: ro, but it must be written"):
        hung(bench, Brake(by="host", output=16, **TIMES), eds=with_outputs(tmp_path, "ro"))


@pytest.mark.parametrize("wrong", [{"by": "host"}, {"output": 3}, {"by": "host", "output": 32}])
def test_who_works_the_brake_and_how_is_stated_once(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="output"):
        Brake(**TIMES, **wrong)


WRITES = ("2b", "2f", "23", "27", "21")
OTHERS = 0x000A0005  # outputs that are not the brake's


def left_enabled(bench: MakeBench, brake: Brake, outputs: int | None = None, **values: Any) -> Bench:
    """A rig whose master died without a stop, with the weight held by the torque and the brake open."""
    b = hung(bench, brake, outputs, **values)
    b.rig.start()
    b.run(100, WEIGHT)
    motor: Any = b.drives[0].servo.motor
    b.drives[0].servo.measure()
    motor.velocity = 0.0
    return b


@pytest.mark.parametrize(
    ("output", "released", "set_", "opened"),
    [(16, None, OTHERS & ~0x10000, OTHERS | 0x10000), (16, 0, OTHERS | 0x10000, OTHERS), (0, 0, OTHERS, OTHERS & ~1)],
)
def test_the_brake_is_the_first_write_and_the_disable_waits_for_it(bench, tmp_path, output, released, set_, opened):
    brake = Brake(by="host", output=output, released=released, **TIMES)
    b = left_enabled(bench, brake, OTHERS, eds=with_outputs(tmp_path))
    held, begin = b.drives[0].servo.motor.position, len(b.frames)
    b.rig.start()
    sent = [(time, f"{can_id:03x} {data.hex()}") for time, can_id, data, is_rx in b.frames[begin:] if not is_rx]
    low, high, mask = (value.to_bytes(4, "little").hex() for value in (set_, opened, 1 << output))
    assert [text for _, text in sent[:9]] == [
        "605 4000100000000000",  # who is it
        "605 40fe600100000000",  # its outputs, once
        f"605 23fe6001{low}",
        "605 40fe600100000000",
        "605 40fe600200000000",
        f"605 23fe6002{mask}",
        "605 40fe600200000000",
        "605 4041600000000000",
        "605 2b40600000000000",  # only now disabled
    ]
    assert sent[8][0] - sent[7][0] == 50_000_000
    assert (f"605 23fe6001{high}") in [text for _, text in sent[9:]]
    assert b.drives[0].servo.motor.position == pytest.approx(held, abs=2e-5)  # 0 mm but for the first torque-free SYNCs
    b.rig.stop()  # and it does not restore an open brake
    outputs = [data.hex() for data in b.sent(0x605) if data.hex().startswith("23fe6001")]
    assert outputs[-1] == f"23fe6001{low}"


def test_a_drive_that_works_its_brake_holds_the_weight_until_it_does(bench: MakeBench) -> None:
    b = left_enabled(bench, Brake(**TIMES))
    held, begin = b.drives[0].servo.motor.position, len(b.frames)
    b.rig.start()
    sent = [(time, data.hex()) for time, can_id, data, is_rx in b.frames[begin:] if not is_rx and can_id == 0x605]
    writes = [(time, text) for time, text in sent if text.startswith(WRITES)]
    assert [text for _, text in writes[:2]] == ["2b40600007000000", "2b40600000000000"]
    assert writes[1][0] - writes[0][0] == 50_000_000
    assert b.drives[0].servo.motor.position == pytest.approx(held, abs=2e-5)


def test_without_an_answer_of_the_outputs_none_of_them_is_written_also_at_the_stop(bench: MakeBench, tmp_path) -> None:
    b = hung(bench, Brake(by="host", output=16, **TIMES), eds=with_outputs(tmp_path))
    b.rig.start()
    b.rig.stop()  # this start read them
    begin = len(b.sent(0x605))
    b.tampered.on_receive = lambda frame: None if bytes(frame.data[1:4]) == b"\xfe\x60\x01" else frame
    with pytest.raises(StartError, match="brake: read 0x60fe:01"):
        b.rig.start()
    frames = [data.hex() for data in b.sent(0x605)[begin:] if data[1:3] == b"\xfe\x60" and data[0] != 0x80]
    assert frames == ["40fe600100000000"]


def test_a_drive_that_the_start_has_not_reached_is_left_to_hold_its_weight(bench: MakeBench, tmp_path: Path) -> None:
    brake = Brake(by="host", output=16, **TIMES)
    b = started(bench, [axis(n, brake=brake, eds=with_outputs(tmp_path), watchdog=False) for n in (5, 6)])
    b.run(100, WEIGHT)
    begin = len(b.frames)
    b.tampered.on_receive = lambda frame: None if bytes(frame.data[1:4]) == b"\xfe\x60\x01" else frame
    with pytest.raises(StartError, match="axis5: brake"):
        b.rig.start()
    sent = [(can_id, data) for _, can_id, data, is_rx in b.frames[begin:] if not is_rx]
    assert {data[0] for can_id, data in sent if can_id in (0x606, 0x206)} == {0x40}
    assert [data for can_id, data in sent if can_id == 0 and data[1] in (0, 6)] == []
    assert (b.drives[0].state, b.drives[1].state) == (DriveState.SWITCH_ON_DISABLED, DriveState.OPERATION_ENABLED)


@pytest.mark.parametrize("foreign", [5, 6])
@pytest.mark.parametrize("how", ["vendor", "device type"])
def test_a_foreign_drive_is_sent_nothing_but_reads(bench: MakeBench, tmp_path: Path, foreign: int, how: str) -> None:
    brake = Brake(by="host", output=3, **TIMES)
    other = {"vendor_id": 0xBAD} if how == "vendor" else {}
    b = bench([axis(n, brake=brake, eds=with_outputs(tmp_path), **(other if n == foreign else {})) for n in (5, 6)])
    drive = b.drives[foreign - 5]
    drive.wake(0)
    if how == "device type":
        drive.store.entry(0x1000, DataType.UNSIGNED32).value = 0x00020191
    with pytest.raises(StartError, match=how):
        b.rig.start()
    with pytest.raises(StartError, match=how):
        b.rig.reset_faults()
    b.rig.stop()
    assert {(can_id, data[0]) for _, can_id, data, is_rx in b.frames if not is_rx} <= {(0x605, 0x40), (0x606, 0x40)}


@pytest.mark.parametrize(
    ("wrong", "named"),
    [({"by": "host", "output": 0}, "bit 0 without `released`"), ({"released": 1}, "released: got 1 with by: drive")],
)
def test_the_polarity_of_the_profiles_own_brake_bit_is_said(wrong: dict[str, Any], named: str) -> None:
    with pytest.raises(ValueError, match=named):
        Brake(**TIMES, **wrong)
