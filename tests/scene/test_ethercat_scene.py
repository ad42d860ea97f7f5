"""One scene on EtherCAT and on CAN: the same torques and the same account; faults, mixed rigs, and what is refused."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from canhaptic.audit.inspection import inspect
from canhaptic.audit.recompute import cycles_on_line
from canhaptic.cli.main import main
from canhaptic.control.verdict import COUNTS_DISAGREE
from canhaptic.cycle import run as run_cycle
from canhaptic.drive.safety.link_policy import StopReason
from canhaptic.errors import HoldsContradictedError, InputError, SceneError
from canhaptic.lab.studies.accuracy.loop_sensitivity import _delays
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.replay import replay_line
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene, scene_from_mapping
from canhaptic.scene.models import Scene
from canhaptic.sim.drive.ethercat.cable import CableEffects
from tools.count_structure import loaded_modules

ROOT = Path(__file__).resolve().parents[2]
SCENE, TWIN = ROOT / "configs/ethercat.yaml", ROOT / "configs/ethercat_on_can.yaml"
SOON = "simulation.user.motion={type: sinusoid, amplitude: 0.6 rad, frequency: 4 Hz, phase: 180 deg}"


def run(scene: Scene, cycles: int = 250) -> tuple[list[Any], Any, Any]:
    """Return what each cycle read and sent, the account, and the error that ended the run."""
    experiment = build(scene)
    rig, seen = experiment.rig, list[Any]()
    write = rig.write_torques

    def noted(torques: Any) -> None:
        seen.append([(s.position, s.torque_applied, s.fresh) for s in rig._samples] + list(torques))
        write(torques)

    rig.write_torques = noted
    account, error = experiment.run_through(cycles)
    return seen, account, error


def both() -> dict[str, Any]:
    """Return a scene with two drives on an EtherCAT line and one on a CAN bus."""
    one, other = (yaml.safe_load(path.read_text().replace("0x6502", "'0x6502'")) for path in (SCENE, TWIN))
    [axis], [pedal] = one["axes"], other["axes"]
    one["bus"] = [{**one["bus"], "name": "arm"}, {"name": "pedals", "interface": "virtual"}]
    second = {**axis, "bus": "arm", "name": "wrist", "position": 1}
    one["axes"] = [{**axis, "bus": "arm"}, second, {**pedal, "bus": "pedals", "name": "pedal"}]
    return dict(one)


def test_the_same_scene_on_can_and_on_ethercat_has_the_same_torques_and_the_same_account() -> None:
    on_can, on_ethercat = (run(load_scene(path, [SOON])) for path in (TWIN, SCENE))
    assert any(torque for *_, torque in on_can[0])
    assert on_can[0] == on_ethercat[0]
    assert on_can[1]["ports"] == on_ethercat[1]["ports"]
    assert on_ethercat[1]["ports"]["handle"]["verdict"] == "yes"


def display_on(bus: str, name: str) -> Scene:
    """Return a shipped scene of admittance displays, on its CAN bus or on a line."""
    path = ROOT / "configs/admittance" / name
    scene = yaml.load(path.read_text(), yaml.BaseLoader)
    if bus == "ethercat":
        scene["bus"] = {"type": "ethercat", "rate": scene["bus"]["rate"]}
        for place, axis in enumerate(scene["axes"]):
            del axis["node_id"], axis["eds"]
            axis |= {"position": place, "esi": "ethercat_servo.xml"}
    return scene_from_mapping(scene, str(path))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["wall.yaml", pytest.param("virtual_mass.yaml", marks=pytest.mark.slow)])  # mode 8, 9
def test_an_admittance_display_moves_and_is_accounted_for_on_ethercat_as_on_can(name: str) -> None:
    on_can, on_line = (run(display_on(bus, name), 150) for bus in ("can", "ethercat"))
    assert any(command for *_, command in on_can[0])
    assert on_can[0] == on_line[0]
    assert on_can[1]["ports"] == on_line[1]["ports"]
    assert on_line[2] is None


@pytest.mark.slow
@pytest.mark.parametrize("name", ["wall.yaml", "virtual_mass.yaml"])
def test_displays_on_a_line_that_loses_frames_are_replayed_byte_for_byte(name: str, tmp_path: Path) -> None:
    scene = display_on("ethercat", name)
    faults = CableEffects(drift=4e-5, late=0.01, lost=0.01, answer_lost=0.01, low_counter=0.005)
    scene, log = replace(scene, cable_effects=faults), tmp_path / "line.pcap"
    _, error = build(scene, bus_log=log).run_through(400)
    assert error is None
    result = replay_line(log, scene, cycles=cycles_on_line(log, scene))
    assert (result.difference, result.compared) == ("", result.recorded)


def test_a_force_sensor_with_a_can_node_of_its_own_is_refused_on_a_line() -> None:
    with pytest.raises(SceneError, match=r"admittance\.force\.node is a node of a CAN bus, expected force\.object"):
        display_on("ethercat", "force_node.yaml")


def test_one_frame_a_cycle_costs_a_hold_and_the_verdict_is_still_right() -> None:
    scene = load_scene(SCENE, [SOON, "bus.frames=1"])
    assert scene.axes[0].loop.delay == 2
    account, error = run(scene)[1:]
    assert error is None
    assert account["ports"]["handle"]["verdict"] == "yes"


def test_a_study_of_accuracy_offers_another_rpdo_on_a_can_bus_alone() -> None:
    on_line, on_can = (load_scene(path) for path in (SCENE, TWIN))
    assert [variant.group for variant in _delays(on_can, on_can)] == ["RPDO"]
    assert list(_delays(on_line, on_line)) == []


def test_a_count_of_held_torques_that_contradicts_the_host_is_a_no_in_run_and_log_which_has_the_phase(tmp_path) -> None:
    experiment = build(load_scene(SCENE, [SOON, "simulation.bus={drift: 80 ppm}"]), energy_log=tmp_path / "run.h5")
    drive: Any = experiment.cables[""].drives[0]
    counter = drive.store.find(0x1C32, 11)

    def miscount(cycle: int) -> None:
        counter.value += cycle == 120

    account, error = experiment.run_through(200, progress=miscount)
    assert isinstance(error, HoldsContradictedError)
    assert experiment.rig.stop_reason is StopReason.HOLDS_CONTRADICTED
    handle = account["ports"]["handle"]
    assert (handle["passive"], handle["verdict"], handle["why"]) == ("no", "no", COUNTS_DISAGREE)
    with EnergyLog(tmp_path / "run.h5") as log:
        assert 1 < np.abs(log.timing["phase"]).max() < 1000  # [ns]
        seen = inspect(log)
    assert [seen["ports"]["handle"][key] for key in ("passive", "verdict", "why")] == ["no", "no", COUNTS_DISAGREE]
    assert 1e-9 < seen["timing"]["phase"]["max"] < 1e-6
    assert {"fault", "hold"} < {event["kind"] for event in seen["events"]}


@pytest.mark.slow_but("falls_to_safe_op*")
@pytest.mark.parametrize(
    ("effect", "reason"),
    [("falls_to_safe_op: 0.1 s", StopReason.NMT_STATE_LEFT), ("broken_at: 0.1 s", StopReason.TPDO_LOST)],
)
def test_a_fault_of_the_line_ends_a_rig_of_both_kinds_of_bus_without_torque(effect: str, reason: StopReason) -> None:
    key, _, value = effect.partition(": ")
    scene = both()
    scene["simulation"]["bus"] = {key: value}
    experiment = build(scene_from_mapping(scene, str(SCENE)))
    _, error = experiment.run_through(400)
    assert error is not None
    assert experiment.rig.stop_reason is reason
    assert experiment.far_side is not None
    experiment.clock.wait_until(experiment.clock.now() + 20_000_000)  # a drive that is cut off has its watchdog
    assert [drive.torque for drive in experiment.far_side.drives] == [0.0] * 3


@pytest.mark.slow
def test_each_kind_of_bus_has_its_own_faults_in_one_rig() -> None:
    scene = both()
    scene["simulation"]["bus"] = {"lost": "2 %", "drop": "2 %"}
    account, error = build(scene_from_mapping(scene, str(SCENE))).run_through(300)
    assert error is None
    assert account["bus_effects"]["arm"]["lost"] > 0
    assert account["link"]["missed_tpdos"] > account["link"]["unanswered"] > 0


@pytest.mark.parametrize(("make", "voided"), [(both, 2), (lambda: yaml.safe_load(SCENE.read_text()), 0)])
def test_a_late_sync_voids_certificates_where_a_drive_on_can_takes_its_hold_from_it(make: Any, voided: int) -> None:
    scene = make()
    scene["simulation"]["bus"] = {"drift": "90 ppm"}
    experiment = build(scene_from_mapping(scene, str(SCENE)))
    rig, clock = experiment.rig, experiment.clock

    def late(cycles: int) -> None:
        if cycles == 20:
            clock.wait_until(rig._pace.due + rig.bus.sample_time_ns // 5)

    with experiment:
        run_cycle(experiment.cycle, 40, progress=late)
    assert experiment.cycle.uneven == voided


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ("bus.node=1", "bus.node: unknown key; expected one of: assign_activate, frames, "),
        ("bus.sync=sm2", "bus.sync: got 'sm2', expected 'dc'"),
        ("bus.startup=[]", "startup: a line has none.*drive_objects of the axis"),
        ("bus.rate=100 Hz", "watchdog is 10 ms, expected at least 30 ms, 3 sample times at 100 Hz"),
        ("bus.type=profinet", "bus.type: got 'profinet', expected one of: can, ethercat"),
        ("axes.0.position=2", r"got axes at positions \[2\] of the line, expected 0 to 0"),
        ("axes.0.esi=nothing.xml", "axes.0.esi: got 'nothing.xml', no such file.*ESI"),
        ("simulation.bus={drop: 0.1}", "simulation.bus.drop: unknown key"),
        ("axes.0.product_code=0x99", "got product 0x99, expected one of 0x1234"),
    ],
)
def test_what_a_line_cannot_serve_is_refused(change: str, text: str) -> None:
    with pytest.raises(SceneError, match=text):
        load_scene(SCENE, [change])


@pytest.mark.parametrize("effect", ["drift", "late", "lost", "answer_lost", "low_counter"])
def test_faults_of_an_ethercat_line_are_refused_for_a_can_bus(effect: str) -> None:
    with pytest.raises(SceneError, match=f"simulation.bus.{effect}: unknown key"):
        load_scene(TWIN, [f"simulation.bus={{{effect}: 0.1}}"])


@pytest.mark.parametrize("first", ["can", "ethercat"])
def test_a_line_that_is_not_the_first_bus_and_a_second_line_are_refused(first: str) -> None:
    scene = both()
    if first == "can":
        scene["bus"].reverse()
        scene["bus"][0]["rate"] = "1 kHz"
        del scene["bus"][1]["rate"]
    else:
        scene["bus"][1]["type"] = "ethercat"
    said = (
        "a line comes first, since its clock leads the cycle, and there is one line in a rig.* put its drives on the fi"
    )
    with pytest.raises(SceneError, match=said):
        scene_from_mapping(scene, str(SCENE))


def test_a_bus_log_of_a_line_and_a_can_bus_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="has CAN buses, or one EtherCAT line; leave --bus-log out"):
        build(scene_from_mapping(both(), str(SCENE)), bus_log=tmp_path / "frames.log")


@pytest.mark.slow
def test_new_writes_a_scene_of_the_drive_of_an_esi_that_runs_simulated_and_is_marked_on_an_interface(tmp_path, capsys):
    place, esi = tmp_path / "rig.yaml", str(ROOT / "eds/ethercat_servo.xml")
    assert main(["new", esi, "--simulate", "--out", str(place)]) == 0
    account, error = build(load_scene(place)).run_through(50)
    assert error is None
    assert account["cycles"] == 50
    assert main(["new", esi, "--interface", "eth7"]) == 0
    assert "interface: eth7             # TO SET" in capsys.readouterr().out
    assert main(["new", esi, "--display", "velocity"]) == 2
    assert "--display: got one for an ESI" in capsys.readouterr().err


@pytest.mark.slow
def test_a_rig_on_a_line_is_commissioned_as_on_can_and_its_hold_is_confirmed_at_the_next_start(tmp_path: Path) -> None:
    done = tmp_path / "done.yaml"
    assert main(["commission", str(SCENE), "--yes", "--duration", "1", "--out", str(done)]) == 0
    experiment = build(load_scene(done, [SOON]))
    account, error = experiment.run_through(250)
    assert error is None
    assert account["ports"]["handle"]["hold"] == "checked at commissioning"
    assert account["ports"]["handle"]["verdict"] == "yes"


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_rig_of_a_line_and_a_can_bus_is_commissioned(tmp_path: Path) -> None:
    """Each drive is watched for as long as its own bus lets it be silent."""
    mixed, done = tmp_path / "mixed.yaml", tmp_path / "done.yaml"
    mixed.write_text(yaml.safe_dump(both()))
    assert main(["commission", str(mixed), "--yes", "--duration", "1", "--out", str(done)]) == 0


@pytest.mark.slow
def test_a_can_rig_loads_nothing_of_ethercat() -> None:
    modules = loaded_modules(ROOT, scene=str(TWIN), duration=0.02)
    assert "canhaptic.drive.can.servo_drive" in modules
    assert not [name for name in modules if "ethercat" in name or name == "canhaptic.canopen.esi"]


def test_the_hash_of_a_can_scene_is_that_before_there_were_other_buses() -> None:
    resolved = load_scene(ROOT / "configs/demo.yaml").hashed()
    assert "type" not in resolved["bus"]
    assert "esi" not in resolved["axes"]["handle"]
