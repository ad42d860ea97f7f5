"""Homing by the drive itself: started by bit 4, watched, and halted and disabled on every way out."""

import itertools
from collections.abc import Callable, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import can
import pytest

from canhaptic.canopen.attached_devices import Brake
from canhaptic.canopen.eds import read_dictionary
from canhaptic.drive.homing import HomingDrive, HomingOrder, home
from canhaptic.errors import InputError, LinkError, RigError, StartError
from canhaptic.sim.drive.profile.state_machine import DriveState
from tests.drive.drive_bench import OUR_EDS, Bench, MakeBench, axis

NEVER: Callable[[], bool] = lambda: False  # noqa: E731
HERE = HomingOrder(method=37, speeds=(0.02, 0.01), timeout=5.0)
UP = HomingOrder(method=34, speeds=(0.02, 0.01), timeout=5.0)
_VARIABLES = {
    "6098": (0x02, "rw", 0),
    "607C": (0x04, "rw", 250),
}


def with_homing(folder: Path, more: Mapping[str, tuple[int, str, int]] | None = None, without: str = "") -> Path:
    """Our dictionary with the objects of the homing, and further ones; `without` makes one of ours read-only."""
    text = OUR_EDS.read_text(encoding="utf-8")
    if without:
        head, tail = text.split(f"[{without}]", 1)
        text = f"{head}[{without}]" + tail.replace("AccessType=rww", "AccessType=ro", 1)
    for name, (kind, access, value) in {**_VARIABLES, **(more or {})}.items():
        text += f"\n[{name}]\nParameterName=Object {name}\nObjectType=0x7\nDataType=0x{kind:04X}\n"
        text += f"AccessType={access}\nDefaultValue={value}\nPDOMapping=0\n"
    text += "\n[6099]\nParameterName=Homing speeds\nObjectType=0x8\nSubNumber=3\n"
    for sub, kind, access in ((0, 5, "ro"), (1, 7, "rw"), (2, 7, "rw")):
        text += f"\n[6099sub{sub}]\nParameterName=Speed {sub}\nObjectType=0x7\nDataType=0x{kind:04X}\n"
        text += f"AccessType={access}\nDefaultValue={2 if sub == 0 else 77}\nPDOMapping=0\n"
    path = folder / "homing.eds"
    path.write_text(text, encoding="utf-8")
    return path


def homed(
    make: MakeBench, folder: Path, order: HomingOrder, values: Mapping[str, Any] | None = None, **eds: Any
) -> tuple[Bench, HomingDrive]:
    parameters = axis(eds=with_homing(folder, **eds), **{"torque_limit": 2.0, **(values or {})})
    b = make([parameters])
    dictionary = read_dictionary(parameters.eds, parameters.node_id)
    return b, HomingDrive(b.links[0], parameters, dictionary, b.rig.drives[0].bus, order)


def controlwords(b: Bench) -> list[int]:
    """Controlwords of the RPDOs, decoded by hand, each as often as it changed."""
    return [word for word, _ in itertools.groupby(int.from_bytes(d[:2], "little") for d in b.sent(0x205))]


def is_left_at_rest(b: Bench) -> bool:
    return b.drives[0].state is DriveState.SWITCH_ON_DISABLED and set(b.torques_sent()) <= {0}


def test_the_handshake_is_the_one_of_the_profile_frame_by_frame(bench: MakeBench, tmp_path: Path) -> None:
    b, drive = homed(bench, tmp_path, HERE)
    before, after = home(drive, NEVER) or (0, 0)
    assert (before, after) == (1000, 250)  # 10 mm of 1e5 count/m, and the home offset 0x607C
    written = [data.hex(" ") for data in b.sent(0x605) if data[0] & 0xE0 == 0x20]
    begin = written.index("2b 72 60 00 c8 00 00 00")  # 0x6072: 200 per mille of 10 N are 2 N, before all else
    steps = ("23 99 60 01 d0 07 00 00", "23 99 60 02 e8 03 00 00", "2f 98 60 00 25 00 00 00", "2f 60 60 00 06 00 00 00")
    places = [written.index(step, begin) for step in steps]  # speeds in count/s, method 37, mode 6
    assert places == sorted(places)
    assert controlwords(b) == [0x00, 0x06, 0x07, 0x0F, 0x1F, 0x10F, 0x00]
    words = [int.from_bytes(d[:2], "little") & 0x3400 for d in b.received(0x185)]
    assert [word for word, _ in itertools.groupby(words)][-3:] == [0x0400, 0x1400, 0x0000]
    assert is_left_at_rest(b)
    assert written[-1] != "2f 60 60 00 06 00 00 00"
    assert [text.split(" ")[0] for text in drive.unrestored] == ["0x6072:00"]  # a limit stays, as after a run
    for place, value in (((0x6098, 0), 0), ((0x6099, 1), 77), ((0x6099, 2), 77)):
        assert drive.sdo.read(*place) == value


def test_a_brake_of_the_host_opens_before_the_homing_and_is_set_before_the_drive_is_disabled(bench, tmp_path):
    brake, path = Brake(by="host", output=16, release_time=0.03, set_time=0.05), with_homing(tmp_path)
    text = path.read_text(encoding="utf-8") + "\n[60FE]\nParameterName=Outputs\nObjectType=0x8\nSubNumber=3\n"
    for sub, kind in ((0, 5), (1, 7), (2, 7)):
        text += f"\n[60FEsub{sub}]\nParameterName=Part {sub}\nObjectType=0x7\nDataType=0x{kind:04X}\n"
        text += f"AccessType={'rw' if sub else 'ro'}\nDefaultValue={0 if sub else 2}\nPDOMapping=0\n"
    path.write_text(text, encoding="utf-8")
    parameters = axis(eds=path, torque_limit=2.0, brake=brake)
    b = bench([parameters], drive_values={"brake": brake})
    dictionary = read_dictionary(parameters.eds, parameters.node_id)
    assert home(HomingDrive(b.links[0], parameters, dictionary, b.rig.drives[0].bus, HERE), NEVER) is not None
    steps: list[tuple[int, int, int]] = []
    for time, can_id, data, is_rx in b.frames:
        if not is_rx and (can_id == 0x205 or (can_id == 0x605 and data[:4] == bytes.fromhex("23 fe 60 01"))):
            word = int.from_bytes(data[4:] if can_id == 0x605 else data[:2], "little")
            if [step[:2] for step in steps[-1:]] != [(can_id, word)]:
                steps.append((can_id, word, time))
    opened, begun, closed = (
        next(n for n, step in enumerate(steps) if step[:2] == of and n > after)
        for of, after in (((0x605, 1 << 16), 0), ((0x205, 0x1F), 0), ((0x605, 0), len(steps) // 2))
    )
    assert steps[opened - 1][:2] == (0x205, 0x0F)  # enabled in homing mode, at rest
    assert steps[begun][2] - steps[opened][2] >= 0.03e9
    assert steps[closed - 1][:2] == (0x205, 0x10F)  # halted
    end = next(step for step in steps[closed:] if step[:2] == (0x205, 0x00))
    assert end[2] - steps[closed][2] >= 0.05e9


@pytest.mark.slow_but("1-33-0")
@pytest.mark.parametrize(("method", "home_at"), [(34, 4096), (33, 0)])
@pytest.mark.parametrize("direction", [1, -1])
def test_the_axis_moves_to_the_next_index_and_stays_there(bench: MakeBench, tmp_path, method, home_at, direction):
    b, drive = homed(bench, tmp_path, UP._replace(method=method), {"direction": direction})
    servo = b.drives[0].servo
    servo._counts_per_unit *= direction  # a drive mounted the other way round
    servo._torque_sign *= direction
    servo.measure()
    home_at -= 4096 if direction < 0 else 0  # 1000 counts are -1000 where the drive is mounted the other way round
    before, after = home(drive, NEVER) or (0, 0)
    assert before == 1000 * direction
    true = servo.motor.position * servo._counts_per_unit
    assert after - 250 == pytest.approx(true - home_at, abs=12.0)  # the zero is where the index is
    assert true == pytest.approx(home_at, abs=60.0)
    largest = max(abs(int.from_bytes(d[6:8], "little", signed=True)) for d in b.received(0x185))
    assert 0 < largest <= 200  # per mille: the drive's own torque, within 0x6072
    assert is_left_at_rest(b)


def at_call(number: int, act: Callable[[], object]) -> Callable[[], bool]:
    """Never asks to stop, and acts at one of its calls."""
    calls = iter(range(10_000))

    def stopped() -> bool:
        if next(calls) == number:
            act()
        return False

    return stopped


def show_bits(b: Bench, bits: int, when: Callable[[], bool]) -> None:
    """Sets bits in the upper byte of the statusword."""

    def tamper(message: can.Message) -> can.Message:
        if message.arbitration_id == 0x185 and when():
            message.data[1] |= bits
        return message

    b.tampered.on_receive = tamper


def test_a_stop_in_the_middle_halts_and_disables(bench: MakeBench, tmp_path: Path) -> None:
    b, drive = homed(bench, tmp_path, UP)
    calls = iter(range(10_000))
    assert home(drive, lambda: next(calls) >= 400) is None
    motor = b.drives[0].servo.motor
    assert 0.011 < motor.position < 0.03
    assert abs(motor.velocity) < 1e-3  # [m/s] of 0.01 m/s: it was halted before its torque went
    assert controlwords(b)[-3:] == [0x1F, 0x10F, 0x00]
    assert is_left_at_rest(b)


def test_a_second_signal_in_the_middle_disables_at_once(bench: MakeBench, tmp_path: Path) -> None:
    b, drive = homed(bench, tmp_path, UP)

    def signal() -> None:
        raise SystemExit(130)

    with pytest.raises(SystemExit):
        home(drive, at_call(400, signal))
    assert controlwords(b)[-2:] == [0x1F, 0x00]
    assert is_left_at_rest(b)


def test_a_home_that_is_not_found_in_time_ends_at_rest(bench: MakeBench, tmp_path: Path) -> None:
    b, drive = homed(bench, tmp_path, UP._replace(timeout=0.2))
    with pytest.raises(RigError, match=r"no home within 0\.2 s .*; it was halted and disabled"):
        home(drive, NEVER)
    assert is_left_at_rest(b)


def test_a_homing_error_of_the_drive_ends_at_rest(bench: MakeBench, tmp_path: Path) -> None:
    b, drive = homed(bench, tmp_path, UP)
    show_bits(b, 0x20, lambda: controlwords(b)[-1:] == [0x1F])
    with pytest.raises(RigError, match=r"homing error \(bit 13"):
        home(drive, NEVER)
    assert is_left_at_rest(b)


def test_a_silent_drive_is_disabled_though_nothing_of_it_is_heard(bench: MakeBench, tmp_path: Path) -> None:
    b, drive = homed(bench, tmp_path, UP)
    with pytest.raises(LinkError):
        home(drive, at_call(300, lambda: b.tampered.drop(0x185)))
    assert is_left_at_rest(b)


def test_a_speed_in_another_unit_is_stopped_after_a_few_syncs(bench: MakeBench, tmp_path: Path) -> None:
    b, drive = homed(bench, tmp_path, UP)
    homing = b.drives[0].servo._homing
    assert homing is not None
    homing._speed = SimpleNamespace(number=60 * 1000)  # type: ignore[assignment]
    with pytest.raises(RigError, match="more than twice as fast as asked"):
        home(drive, NEVER)
    assert abs(b.drives[0].servo.motor.position) < 0.05  # [m]: 0.6 m/s would be there in a tenth of a second
    assert is_left_at_rest(b)


def test_a_drive_with_another_velocity_unit_is_refused_before_it_is_enabled(bench: MakeBench, tmp_path: Path) -> None:
    b, drive = homed(bench, tmp_path, UP, more={"60A9": (0x07, "rw", 0x00B44700)})  # rev/min, as EPOS4 has it
    with pytest.raises(StartError, match="velocity unit: got 0x60A9: 0x00b44700, expected counts per second"):
        home(drive, NEVER)
    assert b.sent(0x205) == [] or set(controlwords(b)) == {0x00}
    assert is_left_at_rest(b)


def test_a_drive_that_counts_in_counts_per_second_is_homed(bench: MakeBench, tmp_path: Path) -> None:
    _, drive = homed(bench, tmp_path, HERE, more={"60A9": (0x07, "rw", 0x00B50300)})
    assert home(drive, NEVER) == (1000, 250)


def test_a_method_that_the_drive_does_not_have_is_refused_before_it_is_enabled(bench: MakeBench, tmp_path) -> None:
    b, drive = homed(bench, tmp_path, UP._replace(method=17))
    with pytest.raises(StartError, match="homing"):
        home(drive, NEVER)
    assert set(controlwords(b)) <= {0x00}
    assert is_left_at_rest(b)


def test_an_old_result_in_the_statusword_is_not_taken_for_the_new_one(bench: MakeBench, tmp_path: Path) -> None:
    b, drive = homed(bench, tmp_path, UP._replace(timeout=0.4))
    show_bits(b, 0x14, lambda: True)  # attained and reached, all the time
    with pytest.raises(RigError, match="no home within"):
        home(drive, NEVER)


@pytest.mark.parametrize(
    ("order", "values", "message"),
    [
        (UP._replace(method=23), {}, "--method: got 23, expected one of 1, 2, 17"),
        (UP._replace(speeds=(0.0, 0.1)), {}, "--speed: got 0 m/s"),
        (UP._replace(speeds=(0.1, float("nan"))), {}, "--speed: got nan m/s"),
        (UP._replace(speeds=(1.0, 0.1)), {"speed_limit": 0.5}, "--speed: got 1 m/s, expected at most 0.5 m/s"),
        (UP._replace(timeout=float("inf")), {}, "--timeout: got inf s"),
        (UP, {"watchdog": False}, "watchdog: false: a killed program would leave the axis moving"),
    ],
)
def test_an_order_that_is_not_safe_sends_nothing(bench: MakeBench, tmp_path, order: HomingOrder, values, message):
    with pytest.raises(InputError) as caught:
        homed(bench, tmp_path, order, values)
    assert message in str(caught.value)


def test_a_drive_without_a_homing_over_the_bus_is_refused(bench: MakeBench) -> None:
    b = bench()
    parameters = axis()
    with pytest.raises(InputError, match="lists no writable 0x6098:00"):
        HomingDrive(b.links[0], parameters, read_dictionary(parameters.eds, 5), b.rig.drives[0].bus, UP)
    assert b.frames == []


def test_whether_the_drive_takes_the_limit_of_the_torque_is_known(bench: MakeBench, tmp_path: Path) -> None:
    assert homed(bench, tmp_path, UP)[1].takes_limit
    assert not homed(bench, tmp_path, UP, {"quirks": ("max_torque_absent",)})[1].takes_limit
    assert not homed(bench, tmp_path, UP, without="6072")[1].takes_limit
