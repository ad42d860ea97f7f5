"""The preflight of SocketCAN, on what `ip -details -statistics -json link show` prints, word by word."""

import json
import subprocess

import pytest

from canhaptic.cli.main import main
from canhaptic.cycle import run
from canhaptic.errors import LinkError
from canhaptic.host import socketcan_state as preflight_module
from canhaptic.host.findings import PreflightFinding
from canhaptic.host.socketcan_state import (
    _least_restart,
    all_links_are_virtual,
    preflight,
    require_preflight,
)
from canhaptic.scene.build import build
from canhaptic.scene.buses import can_bus
from canhaptic.scene.load import load_scene
from canhaptic.scene.models import Scene
from tests.scene.scene_text import REPOSITORY

EXAMPLE = REPOSITORY / "configs" / "interfaces" / "socketcan.yaml"
DEMO = REPOSITORY / "configs" / "demo.yaml"

# iproute2 6.1, an SJA1000 controller at 1 Mbit/s
WELL = (
    '[{"ifindex":3,"ifname":"can0","flags":["NOARP","UP","LOWER_UP","ECHO"],"mtu":16,"qdisc":"pfifo_fast",'
    '"operstate":"UP","linkmode":"DEFAULT","group":"default","txqlen":64,"link_type":"can","promiscuity":0,'
    '"allmulti":0,"min_mtu":0,"max_mtu":0,"linkinfo":{"info_kind":"can","info_data":{"state":"ERROR-ACTIVE",'
    '"berr_counter":{"tx":0,"rx":0},"restart_ms":0,"bittiming":{"bitrate":1000000,"sample_point":"0.750","tq":125,'
    '"prop_seg":2,"phase_seg1":3,"phase_seg2":2,"sjw":1,"brp":1},"bittiming_const":{"name":"sja1000","tseg1":'
    '{"min":1,"max":16},"tseg2":{"min":1,"max":8},"sjw":{"min":1,"max":4},"brp":{"min":1,"max":64},"brp_inc":1},'
    '"clock":8000000},"info_xstats":{"restarts":0,"bus_error":0,"arbitration_lost":0,"error_warning":0,'
    '"error_passive":0,"bus_off":0}},"num_tx_queues":1,"num_rx_queues":1,"gso_max_size":65536,"gso_max_segs":65535,'
    '"stats64":{"rx":{"bytes":0,"packets":0,"errors":0,"dropped":0,"over_errors":0,"multicast":0},'
    '"tx":{"bytes":0,"packets":0,"errors":0,"dropped":0,"carrier_errors":0,"collisions":0}}}]'
)
VIRTUAL = (
    '[{"ifindex":5,"ifname":"can0","flags":["NOARP","UP","LOWER_UP"],"mtu":72,"qdisc":"noqueue","operstate":"UNKNOWN",'
    '"linkmode":"DEFAULT","group":"default","txqlen":1000,"link_type":"can","promiscuity":0,"allmulti":0,"min_mtu":0,'
    '"max_mtu":0,"linkinfo":{"info_kind":"vcan"},"num_tx_queues":1,"num_rx_queues":1}]'
)
ETHERNET = '[{"ifindex":2,"ifname":"can0","flags":["UP"],"mtu":1500,"txqlen":1000,"link_type":"ether"}]'


def scene(*overrides: str) -> Scene:
    return load_scene(EXAMPLE, overrides)


def answers(stdout: str, returncode: int = 0, stderr: str = "") -> preflight_module.Runner:
    def run_ip(command: list[str]) -> "subprocess.CompletedProcess[str]":
        assert command == ["ip", "-details", "-statistics", "-json", "link", "show", "dev", "can0"]
        return subprocess.CompletedProcess(command, returncode, stdout, stderr)

    return run_ip


def judged(stdout: str, *overrides: str) -> dict[str, PreflightFinding]:
    return {finding.item: finding for finding in preflight(scene(*overrides).loaded_buses, answers(stdout))}


def changed(old: str, new: str) -> str:
    assert WELL.count(old) == 1
    return WELL.replace(old, new)


def test_an_interface_in_order_passes_without_a_note() -> None:
    found = judged(WELL)
    assert {finding.severity for finding in found.values()} == {"well"}
    assert set(found) == {"link", "txqueuelen", "bit rate", "state", "restart-ms", "error counters"}
    assert require_preflight(scene().loaded_buses, answers(WELL)) == []


def test_a_virtual_can_interface_has_no_controller_to_judge() -> None:
    found = judged(VIRTUAL)
    assert {finding.severity for finding in found.values()} == {"well"}
    assert found["controller"].seen == "none (vcan)"


@pytest.mark.parametrize(
    ("stdout", "item", "words"),
    [
        (changed('"bitrate":1000000', '"bitrate":500000'), "bit rate", "expected 1000000 as bus.bitrate says"),
        (changed('"state":"ERROR-ACTIVE"', '"state":"BUS-OFF"'), "state", "ip link set can0 type can restart"),
        (changed('"state":"ERROR-ACTIVE"', '"state":"STOPPED"'), "state", "ip link set can0 up"),
        (changed('["NOARP","UP","LOWER_UP","ECHO"]', '["NOARP","ECHO"]'), "link", "type can bitrate 1000000"),
        (changed('{"state"', '{"ctrlmode":["LISTEN-ONLY"],"state"'), "mode", "listen-only off"),
        (changed('{"state"', '{"ctrlmode":["LOOPBACK","FD"],"state"'), "mode", "loopback off"),
        (changed('"restart_ms":0', '"restart_ms":5'), "restart-ms", "at least 20 ms (after 20 sample times"),
        (ETHERNET, "link type", "name a CAN interface"),
    ],
)
def test_what_would_fail_or_harm_refuses_the_run(stdout: str, item: str, words: str) -> None:
    finding = judged(stdout)[item]
    assert finding.severity == "refused"
    assert words in finding.text
    with pytest.raises(LinkError) as caught:
        require_preflight(scene().loaded_buses, answers(stdout))
    assert f"can0: {item}: got {finding.seen}" in str(caught.value)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("stdout", "item", "words"),
    [
        (changed('"txqlen":64', '"txqlen":5'), "txqueuelen", "expected at least 8 (two cycles of 1 axes)"),
        (changed('"tx":0,"rx":0}', '"tx":128,"rx":0}'), "error counters", "expected below 96"),
        (changed('"state":"ERROR-ACTIVE"', '"state":"ERROR-PASSIVE"'), "state", "no node acknowledges"),
        (changed('"bus_off":0', '"bus_off":3'), "bus-offs so far", "find the cause"),
        (changed('"bittiming":{"bitrate":1000000,', '"other":{'), "bit rate", "cannot be compared"),
        (changed('"restart_ms":0,', ""), "restart-ms", "cannot be checked"),
    ],
)
def test_what_is_only_unwise_is_a_note(stdout: str, item: str, words: str) -> None:
    finding = judged(stdout)[item]
    assert finding.severity == "note"
    assert words in finding.text
    assert require_preflight(scene().loaded_buses, answers(stdout)) == [finding]


def test_the_fixed_bit_rate_of_a_controller_is_compared_too() -> None:
    stdout = changed('"bittiming":{"bitrate":1000000,', '"bittiming_bitrate":250000,"other":{')
    assert judged(stdout)["bit rate"].severity == "refused"


def test_the_default_queue_is_too_short_for_three_axes_and_not_for_one() -> None:
    stdout = changed('"txqlen":64', '"txqlen":10')
    assert judged(stdout)["txqueuelen"].severity == "well"
    entry = json.loads(stdout)[0]
    found = {f.item: f for f in preflight_module._judge_link("can0", entry, can_bus(scene().bus), axes=3)}
    assert (found["txqueuelen"].severity, found["txqueuelen"].seen) == ("note", "10")


def test_several_faults_are_told_at_once() -> None:
    stdout = changed('"bitrate":1000000', '"bitrate":125000').replace("ERROR-ACTIVE", "BUS-OFF")
    with pytest.raises(LinkError, match=r"bit rate: got 125000.*state: got BUS-OFF"):
        require_preflight(scene().loaded_buses, answers(stdout))


def test_an_interface_that_is_not_there_refuses_the_run() -> None:
    with pytest.raises(LinkError, match="can0: interface: got none"):
        require_preflight(scene().loaded_buses, answers("", 1, 'Device "can0" does not exist.\n'))


@pytest.mark.parametrize(
    ("stdout", "code", "stderr"),
    [
        ("", 1, "ip: unrecognized option: details\nBusyBox v1.35.0\n"),
        ("3: can0: <NOARP,UP>", 0, ""),
        ("[]", 0, ""),
        ('[{"link_type":"can","linkinfo":7,"flags":["UP"]}]', 0, ""),
    ],
)
def test_an_ip_that_cannot_tell_is_a_note_and_no_refusal(stdout: str, code: int, stderr: str) -> None:
    [note] = require_preflight(scene().loaded_buses, answers(stdout, code, stderr))
    assert (note.item, note.severity) == ("ip", "note")
    assert "install iproute2" in note.text


@pytest.mark.parametrize("error", [FileNotFoundError("ip"), subprocess.TimeoutExpired("ip", 5.0)])
def test_without_ip_nothing_is_refused_and_that_is_said(error: Exception) -> None:
    def run_ip(command: list[str]) -> "subprocess.CompletedProcess[str]":
        raise error

    [note] = require_preflight(scene().loaded_buses, run_ip)
    assert "cannot be checked" in note.text


def test_other_interfaces_are_not_looked_at() -> None:
    def run_ip(command: list[str]) -> "subprocess.CompletedProcess[str]":
        raise AssertionError(command)

    assert preflight(load_scene(DEMO).loaded_buses, run_ip) == []


# --- real drives or simulated ones ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("stdout", "is_virtual"),
    [
        (WELL, False),
        (VIRTUAL, True),
        (VIRTUAL.replace("vcan", "vxcan"), True),
        (VIRTUAL.replace("vcan", "slcan"), False),  # a serial adapter: a real bus behind a kernel interface
        (ETHERNET, False),
        ("3: can0: <NOARP,UP>", False),
        ("[]", False),
        ('[{"link_type":"can","linkinfo":7}]', False),
    ],
)
def test_a_bus_without_a_controller_is_told_by_the_kernel(stdout: str, is_virtual: bool) -> None:
    assert all_links_are_virtual(scene().loaded_buses, answers(stdout)) is is_virtual


def test_the_name_of_an_interface_says_nothing() -> None:
    def run_ip(command: list[str]) -> "subprocess.CompletedProcess[str]":
        return subprocess.CompletedProcess(command, 0, WELL.replace("can0", "vcan0"), "")

    assert not all_links_are_virtual(scene("bus.channel=vcan0").loaded_buses, run_ip)


def test_a_bus_that_the_kernel_does_not_know_counts_as_real() -> None:
    def no_ip(command: list[str]) -> "subprocess.CompletedProcess[str]":
        raise FileNotFoundError("ip")

    assert not all_links_are_virtual(scene().loaded_buses, no_ip)
    assert not all_links_are_virtual(scene().loaded_buses, answers("", 1, 'Device "can0" does not exist.'))
    assert not all_links_are_virtual(scene("bus.interface=pcan").loaded_buses, answers(VIRTUAL))
    assert all_links_are_virtual(load_scene(DEMO).loaded_buses, no_ip)  # the virtual bus of this process


def test_a_marked_scene_runs_on_a_virtual_interface_alone(monkeypatch, capsys) -> None:
    for stdout, words in ((WELL, "marked TO SET"), (VIRTUAL, "cannot be opened")):
        monkeypatch.setattr(preflight_module, "_run", answers(stdout))
        assert main(["run", str(EXAMPLE), "--duration", "0.1"]) in (2, 3)
        err = capsys.readouterr().err
        assert ("marked TO SET" in err) is (stdout is WELL)
        assert words in err


# --- what follows a bus-off -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("rate", "least"), [(1000.0, 20), (100.0, 200), (3.0e2, 67)])
def test_the_least_restart_is_the_time_after_which_the_rig_has_stopped(rate: float, least: int) -> None:
    assert _least_restart(can_bus(scene(f"bus.rate={rate}").bus)) == least


@pytest.mark.slow_but("19-False", "20-True")
@pytest.mark.parametrize(("restart_ms", "is_accepted"), [(0, True), (5, False), (19, False), (20, True), (100, True)])
def test_a_restart_that_the_preflight_accepts_finds_the_rig_stopped(restart_ms: int, is_accepted: bool) -> None:
    """The controller is off from 0.2 s on, for `restart_ms`: frames vanish both ways, as on a controller in bus-off.

    The simulated bus is the judge: a run goes on after the restarts that are refused, and after no other.
    """
    assert (judged(changed('"restart_ms":0', f'"restart_ms":{restart_ms}'))["restart-ms"].severity == "well") is (
        is_accepted
    )
    off = restart_ms * 1e-3 or 1.0  # restart-ms 0: until it is restarted
    effects = f"simulation.bus={{drop: 1.0, during: [{{begin: 0.2, duration: {off}}}]}}"
    with build(load_scene(DEMO, [effects])) as experiment:
        assert experiment.far_side is not None
        if is_accepted:
            with pytest.raises(LinkError):
                run(experiment.cycle, cycles=600)
            assert experiment.cycle.cycles < 400
        else:
            run(experiment.cycle, cycles=600)
            assert experiment.cycle.cycles == 600


def test_after_a_bus_off_for_good_the_drive_stops_by_its_own_watchdog() -> None:
    effects = "simulation.bus={drop: 1.0, during: [{begin: 0.2, duration: 5.0}]}"
    with build(load_scene(DEMO, [effects, "environment.position=1 m"])) as experiment:
        with pytest.raises(LinkError):
            run(experiment.cycle, cycles=600)
        assert experiment.far_side is not None
        [drive] = experiment.far_side.drives
        experiment.far_side.process(experiment.clock.now() + 2 * 10**8)
        assert drive.torque == 0.0
        assert drive.state.name in ("FAULT", "FAULT_REACTION_ACTIVE")


# --- the commands ---------------------------------------------------------------------------------------------------


def test_run_refuses_before_it_opens_the_bus(tmp_path, monkeypatch, capsys) -> None:
    without_marks = tmp_path / "rig.yaml"
    eds = REPOSITORY / "eds" / "cia402_servo.eds"
    text = EXAMPLE.read_text().replace("# TO SET", "# set").replace("eds: cia402_servo.eds", f"eds: {eds}")
    known = "    torque_verified: balance\n    position_reference: absolute\n"
    without_marks.write_text(text.replace("    unit: m", f"{known}    unit: m"))
    monkeypatch.setattr(preflight_module, "_run", answers(changed('"bitrate":1000000', '"bitrate":500000')))
    assert main(["run", str(without_marks), "--json"]) == 3
    answer = json.loads(capsys.readouterr().out)
    assert answer["error"] == "LinkError"
    assert "bit rate: got 500000, expected 1000000" in answer["faults"][0]


def test_the_command_shows_every_item(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(preflight_module, "_run", answers(changed('"txqlen":64', '"txqlen":2')))
    assert main(["preflight", str(EXAMPLE)]) == 0
    out = capsys.readouterr().out
    for words in ("can0", "txqueuelen", "note", "bit rate", "1000000", "0 (by hand)"):
        assert words in out
    monkeypatch.setattr(preflight_module, "_run", answers(changed("ERROR-ACTIVE", "BUS-OFF")))
    assert main(["preflight", str(EXAMPLE), "--json"]) == 1
    answer = json.loads(capsys.readouterr().out)
    assert answer["verdict"] == "refused"
    assert {f["severity"] for f in answer["interfaces"] if f["item"] == "state"} == {"refused"}


def test_the_command_says_when_there_is_nothing_to_look_at(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["preflight", str(DEMO)]) == 0
    assert "bus.interface is virtual, not socketcan or" in capsys.readouterr().out


def test_the_ip_of_this_machine_is_asked_for_real() -> None:
    """On any host: an interface that is judged, one that is missing, or no answer, each reported."""
    found = preflight(scene("bus.channel=can99").loaded_buses)
    assert {finding.interface for finding in found} == {"can99"}
    assert all(finding.seen and (finding.text or finding.severity == "well") for finding in found)


@pytest.mark.parametrize(("rate", "fits"), [(200, True), (1000, False)])
def test_the_round_trip_to_each_drive_is_measured_and_judged(rate: int, fits: bool, capsys) -> None:
    usb = "simulation.bus={jitter: 1 ms, bring_up: true}"  # each way up to one frame of full-speed USB
    assert main(["preflight", str(DEMO), "--bus", "--json", "--set", usb, "--set", f"bus.rate={rate}"]) == 0
    (trip,) = json.loads(capsys.readouterr().out)["round_trips"]
    assert trip["fits"] is fits
    assert 0.2e-3 > trip["least"] < trip["median"] < 1.2e-3 < trip["largest"] <= 2.1e-3
    assert 200 <= trip["rate"] < 400
    main(["preflight", str(DEMO), "--bus", "--set", usb, "--set", f"bus.rate={rate}"])
    assert ("lower bus.rate" in " ".join(capsys.readouterr().out.split())) is not fits
