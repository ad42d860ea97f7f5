"""Everything that a start refuses: one clear error, no torque on the bus, the drive not enabled."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import pytest

from canhaptic.drive.can.pdo_map import check_dictionary
from canhaptic.drive.profile.fitness import Verdict, agreed_rated_torque
from canhaptic.errors import BusBudgetError, DictionaryError, InputError, StartError
from canhaptic.sim.drive.profile.state_machine import DriveState
from tests.drive.drive_bench import OUR_EDS, Bench, MakeBench, axis, dictionary, started


def refuse(b: Bench, step: str, *texts: str, says: str = "got ") -> StartError:
    """Starts, expects a refusal at `step` that begins with `says`, and that nothing ever moved."""
    with pytest.raises(StartError) as caught:
        b.rig.start()
    error = caught.value
    assert error.step == step, error
    assert str(error).startswith(f"axis5: {step}: {says}")
    for text in texts:
        assert text in str(error)
    assert set(b.torques_sent()) <= {0}
    assert not b.rig.is_running
    assert b.drives[0].state is not DriveState.OPERATION_ENABLED
    return error


def test_an_absent_drive_is_named_with_what_to_check(bench: MakeBench) -> None:
    texts = ("node 5", "no answer", "check power, node ID, bit rate and cable")
    refuse(bench(absent=True), "presence", *texts, says="read 0x1000:00 Device type: ")


def test_a_drive_in_fault_is_refused_with_its_error_code(bench: MakeBench) -> None:
    b = bench()
    b.drives[0].wake(0)
    b.drives[0].inject_fault(0x3210)
    refuse(b, "drive state", "FAULT", "0x3210")
    assert b.drives[0].state is DriveState.FAULT


def test_a_fault_is_reset_only_when_the_configuration_says_so(bench: MakeBench) -> None:
    b = bench([axis(reset_fault=True)])
    b.drives[0].wake(0)
    b.drives[0].inject_fault(0x3210)
    before = b.clock.now()
    b.rig.start()
    assert b.drives[0].state is DriveState.OPERATION_ENABLED
    assert b.clock.now() - before < 150_000_000


@pytest.mark.parametrize("device_type", [0x00030191, 0x00000000, 0x01920000, 0x00020196])
def test_a_drive_that_is_no_cia_402_device_is_refused(bench: MakeBench, device_type: int) -> None:
    refuse(bench(objects={0x1000: device_type}), "device type", f"{device_type:#010x}", "0x0192")


@pytest.mark.parametrize("device_type", [0x00020192, 0x00420192, 0x00060192, 0x00000192])
def test_the_high_word_of_the_device_type_does_not_matter(bench: MakeBench, device_type: int) -> None:
    b = started(bench, objects={0x1000: device_type})
    assert b.drives[0].state is DriveState.OPERATION_ENABLED


def test_a_drive_whose_modes_lack_bit_9_is_refused(bench: MakeBench) -> None:
    refuse(bench(objects={0x6502: 0xDFF}), "drive modes", "0x6502 = 0xdff", "bit 9")  # all but mode 10


def test_a_drive_with_another_vendor_or_product_is_refused(bench: MakeBench) -> None:
    b = bench([axis(vendor_id=0x9A)], objects={"0x1018.1": 0xFB})
    refuse(b, "identity", "0x1018:01 = 0xfb", "0x9a")


TAMPERINGS: dict[str, tuple[str, str, str, str]] = {
    # what: (SDO answer that begins with, replaced by, step, text in the message)
    "mode write aborted": ("60 60 60 00", "80 60 60 00 30 00 09 06", "mode of operation", "0x06090030"),
    "mode not taken": ("4f 61 60 00", "4f 61 60 00 03 00 00 00", "mode of operation", "0x6061 = 3"),
    "mapping refused": ("60 00 1a 02", "80 00 1a 02 41 00 04 06", "PDO map", "Object cannot be mapped"),
    "mapping count refused": ("60 00 16 00", "80 00 16 00 42 00 04 06", "PDO map", "PDO length exceeded"),
    "entry read back differs": ("43 00 1a 02", "43 00 1a 02 20 00 63 60", "PDO map", "0x6063:00/32"),
    "count read back differs": ("4f 00 1a 00", "4f 00 1a 00 02 00 00 00", "PDO map", "0x2"),
    "type read back differs": ("4f 00 14 02", "4f 00 14 02 ff 00 00 00", "PDO map", "0xff"),
    "TPDO stays off": ("43 00 18 01", "43 00 18 01 85 01 00 80", "PDO map", "0x80000185"),
    "torque limit read back differs": ("4b 72 60 00", "4b 72 60 00 e8 03 00 00", "torque limit", "0x3e8"),
    "watchdog refused": ("60 16 10 01", "80 16 10 01 43 00 04 06", "watchdog", "0x06040043"),
    "rated torque differs": ("43 76 60 00", "43 76 60 00 98 3a 00 00", "rated torque", "15000"),
    "target torque not zero": ("4b 71 60 00", "4b 71 60 00 64 00 00 00", "zero torque", "0x64"),
    "position elsewhere": ("43 64 60 00", "43 64 60 00 00 00 e8 03", "position", "65536000"),
    "device type aborted": ("43 00 10 00", "80 00 10 00 00 00 02 06", "presence", "Object does not exist"),
}


@pytest.mark.parametrize("what", TAMPERINGS)
def test_a_step_that_is_not_confirmed_stops_the_start(bench: MakeBench, what: str) -> None:
    start, replacement, step, text = TAMPERINGS[what]
    b = bench()
    b.tampered.answer(start, replacement)
    refuse(b, step, text)


def test_a_drive_without_heartbeat_is_refused(bench: MakeBench) -> None:
    b = bench()
    b.tampered.drop(0x705)
    refuse(b, "heartbeat", "no heartbeat", "PRE_OPERATIONAL")


def test_nmt_operational_is_believed_only_from_the_heartbeat(bench: MakeBench) -> None:
    def stay(message: can.Message) -> can.Message:
        if message.arbitration_id == 0x705:
            message.data = bytearray(b"\x7f")
        return message

    b = bench()
    b.tampered.on_receive = stay
    refuse(b, "NMT operational", "PRE_OPERATIONAL")


def test_a_drive_that_sends_no_tpdo_is_refused(bench: MakeBench) -> None:
    b = bench()
    b.tampered.drop(0x185)
    refuse(b, "PDO exchange", "0x185")


def with_statusword(statusword: int) -> Callable[[can.Message], can.Message]:
    def tamper(message: can.Message) -> can.Message:
        if message.arbitration_id == 0x185:
            message.data[0:2] = statusword.to_bytes(2, "little")
        return message

    return tamper


def test_a_drive_that_does_not_switch_on_is_refused_with_its_state(bench: MakeBench) -> None:
    b = bench()
    b.tampered.on_receive = with_statusword(0x0231)
    refuse(b, "enable", "READY TO SWITCH ON", "controlword 0x07", "STO")


def test_a_drive_that_faults_while_it_is_enabled_is_refused(bench: MakeBench) -> None:
    b = bench()
    b.tampered.on_receive = with_statusword(0x0208)
    refuse(b, "enable", "expected OPERATION ENABLED")


def test_a_refused_axis_leaves_the_other_axes_disabled_too(bench: MakeBench) -> None:
    b = bench([axis(5), axis(6)])
    b.tampered.answer("4f 61 60 00", "4f 61 60 00 03 00 00 00")
    with pytest.raises(StartError):
        b.rig.start()
    assert all(drive.state is not DriveState.OPERATION_ENABLED for drive in b.drives)
    assert set(b.torques_sent(0x205)) | set(b.torques_sent(0x206)) <= {0}


def test_an_axis_that_was_enabled_already_is_disabled_when_another_refuses(bench: MakeBench) -> None:
    def stay_ready(message: can.Message) -> can.Message:
        if message.arbitration_id == 0x186:
            message.data[0:2] = b"\x31\x02"
        return message

    b = bench([axis(5), axis(6)])
    b.tampered.on_receive = stay_ready
    with pytest.raises(StartError, match="axis6: enable: got READY TO SWITCH ON"):
        b.rig.start()
    assert b"\x0f\0\0\0" in b.sent(0x205)
    assert {drive.state for drive in b.drives} == {DriveState.SWITCH_ON_DISABLED}
    assert set(b.torques_sent(0x205)) | set(b.torques_sent(0x206)) == {0}


def test_a_target_torque_that_is_not_the_one_sent_is_refused_before_the_drive_is_enabled(bench: MakeBench) -> None:
    def other_torque(message: can.Message) -> can.Message:
        if bytes(message.data[:4]) == bytes.fromhex("4b716000") and b.sent(0x080):
            message.data[4] = 0x64
        return message

    b = bench()
    b.tampered.on_receive = other_torque
    refuse(b, "zero torque", "0x6071 = 100 after an RPDO with 0")


def test_a_demand_that_is_not_zero_before_the_drive_is_enabled_is_refused(bench: MakeBench) -> None:
    def other_demand(message: can.Message) -> can.Message:
        if message.arbitration_id == 0x185:
            message.data[6] = 0x64
        return message

    b = bench()
    b.tampered.on_receive = other_demand
    refuse(b, "zero torque", "0x6074 = 100 in the TPDO")


# --- before any drive is asked ------------------------------------------------------------------------------------


def test_a_bus_that_is_too_slow_is_refused_with_the_arithmetic_and_a_way_out(bench: MakeBench) -> None:
    with pytest.raises(BusBudgetError, match=r"685 bits at 500 kbit/s = 1370 us.*rate: 500.*bitrate: 800000"):
        bench(bus={"bitrate": 500_000})


def test_two_axes_with_one_node_id_are_refused(bench: MakeBench) -> None:
    with pytest.raises(InputError, match="node_id 5 is used by left"):
        bench([axis(5, name="left"), axis(5, name="right")])


def test_a_drive_with_the_node_id_of_the_master_is_refused(bench: MakeBench) -> None:
    with pytest.raises(InputError, match=r"node_id 126 is used by the master.*bus\.master_id"):
        bench([axis(126)])


def edited(tmp_path: Path, section: str, **entries: str | None) -> Path:
    """Our dictionary with entries of one section changed, or left out where None."""
    lines, inside = [], False
    for line in OUR_EDS.read_text().splitlines():
        if line.startswith("["):
            inside = line.strip().lower() == f"[{section.lower()}]"
        key = line.partition("=")[0]
        if inside and key in entries:
            if entries[key] is not None:
                lines.append(f"{key}={entries[key]}")
        else:
            lines.append(line)
    path = tmp_path / "edited.eds"
    path.write_text("\n".join(lines))
    return path


def verdicts(path: Path, **values: Any) -> dict[str, Verdict]:
    parameters = axis(eds=path, **values)
    return {f.item.split()[0]: f.verdict for f in check_dictionary(dictionary(parameters), parameters)}


def test_what_a_dictionary_does_not_state_is_unknown_and_not_refused(tmp_path: Path) -> None:
    assert verdicts(edited(tmp_path, "6502", DefaultValue=None))["0x6502"] is Verdict.UNKNOWN
    assert verdicts(edited(tmp_path, "1000", DefaultValue=None))["0x1000"] is Verdict.UNKNOWN
    assert verdicts(edited(tmp_path, "6076", DefaultValue="0"), rated_torque=None)["0x6076"] is Verdict.UNKNOWN


def test_what_a_dictionary_states_wrongly_is_refused(tmp_path: Path) -> None:
    assert verdicts(edited(tmp_path, "6502", DefaultValue="0x6D"))["0x6502"] is Verdict.REFUSED
    assert verdicts(edited(tmp_path, "1000", DefaultValue="0x191"))["0x1000"] is Verdict.REFUSED


def test_our_own_dictionary_is_fit() -> None:
    assert Verdict.REFUSED not in verdicts(OUR_EDS).values()


@pytest.mark.parametrize("counts", [None, 0])
def test_a_rated_torque_that_is_unknown_is_a_clear_error(counts: int | None) -> None:
    with pytest.raises(DictionaryError, match="set rated_torque"):
        agreed_rated_torque(axis(rated_torque=None), counts)


def test_rated_torques_that_disagree_by_more_than_a_thousandth_are_refused() -> None:
    assert agreed_rated_torque(axis(rated_torque=10.0), 10_005) == pytest.approx(10.005)
    with pytest.raises(DictionaryError, match="0x6076 = 10020"):
        agreed_rated_torque(axis(rated_torque=10.0), 10_020)


def test_a_transmission_scales_the_rated_torque_of_the_motor() -> None:
    assert agreed_rated_torque(axis(rated_torque=None, transmission=50.0), 500) == pytest.approx(25.0)


@pytest.mark.parametrize(("limit", "is_above"), [(10.0, False), (20.0, True)])
def test_a_torque_limit_above_the_rated_torque_is_noted(limit: float, is_above: bool) -> None:
    given = axis(rated_torque=10.0, torque_limit=limit)
    found = next(
        finding for finding in check_dictionary(dictionary(given), given) if finding.item == "0x6076 rated torque"
    )
    assert (f"torque_limit {limit:g} is above it, both at the axis" in found.text) is is_above
