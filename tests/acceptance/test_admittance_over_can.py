"""An admittance display through the whole CAN path: modes 8 and 9, judged by the plant at the sensor, and its logs."""

import json
import math
import struct
from itertools import pairwise
from pathlib import Path
from typing import Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canhaptic.canopen.attached_devices import ForceNode
from canhaptic.cli.main import main
from canhaptic.control.admittance import DISPLAY_ALGORITHMS
from canhaptic.control.admittance.group_environment import PathMass, nearest
from canhaptic.cycle import run
from canhaptic.drive.profile.motion_parameters import ForceChannel, ForceParameters
from canhaptic.drive.safety.link_policy import StopReason
from canhaptic.errors import (
    ForceContradictedError,
    ForceFrozenError,
    ForceRangeError,
    InputError,
    LinkError,
    SceneError,
    StartError,
)
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.result import RunResult
from canhaptic.scene.build import Experiment, build, experiment_account
from canhaptic.scene.hints import hints_of
from canhaptic.scene.load import load_scene
from canhaptic.scene.models import require_no_guesses
from canhaptic.sim.drive.profile.state_machine import DriveState

SCENE = Path(__file__).parents[2] / "configs" / "admittance" / "virtual_mass.yaml"
REAL = ["bus.interface=socketcan", "bus.channel=can0", "axes.0.admittance.force.frozen_after=50"]
REAL += ["axes.0.torque_verified=balance", "axes.0.position_reference=absolute"]


def _run(*overrides: str, cycles: int = 1500) -> tuple[RunResult, Experiment]:
    with build(load_scene(SCENE, overrides)) as experiment:
        run(experiment.cycle, cycles)
        return experiment_account(experiment, "completed", 1.0), experiment


@pytest.mark.slow_but("position")
@pytest.mark.parametrize("mode", ["velocity", "position"])
def test_force_comes_in_and_velocity_goes_out(mode: str) -> None:
    account, _ = _run(f"axes.0.admittance.mode={mode}")
    port, truth = account["ports"]["handle"], account["truth"]["handle"]
    assert truth["interaction"] > 0.5  # the hand moved the mass
    assert truth["least_interaction"] >= -1e-3  # the energy allowance of the scene
    assert port["passive"] != "no"  # with an energy allowance no certificate promises more
    assert port["certificate"] in ("velocity_loop", "exact")
    with build(load_scene(SCENE, [f"axes.0.admittance.mode={mode}"])) as begun:
        assert begun.far_side is not None
        shown, modes = begun.far_side.drives[0].store.entry(0x6061, 0x02), set()
        run(begun.cycle, 10, progress=lambda _: modes.add(shown.value))
        assert modes == {9 if mode == "velocity" else 8}


@pytest.mark.slow_but("0.039-none")
@pytest.mark.parametrize(("jitter", "certificate"), [(0.039, "none"), (0.041, "velocity_loop")])
def test_a_display_keeps_its_promise_where_holds_are_as_uneven_as_declared(jitter: float, certificate: str) -> None:
    """SYNCs are up to 0.04 ms of 1 ms late."""
    uneven = "simulation.bus={stall: [{begin: 0.2, duration: 0.04 ms, every: 0.0113}]}"
    account, _ = _run(uneven, f"passivity.sync_jitter={jitter}", "environment.mass=1")
    port, truth = account["ports"]["handle"], account["truth"]["handle"]
    assert port["certificate"] == certificate
    assert truth["interaction"] > 0.1
    assert truth["least_interaction"] >= -1e-3  # the energy allowance of the scene
    assert truth["least_interaction"] >= port["least_interaction"] - 1e-9


def test_a_declared_jitter_raises_the_mass_felt_and_lowers_the_speed_of_the_start() -> None:
    even, uneven = ({hint.what: hint.limit or 0.0 for hint in hints_of(load_scene(SCENE, values))}
                    for values in ((), ("passivity.sync_jitter=20 %",)))  # fmt: skip
    drive_mass, start = 2.1, "speed of the first step from rest"
    least = "mass felt at the first move, at least"
    assert uneven[least] - drive_mass == pytest.approx(1.2 * (even[least] - drive_mass))
    assert uneven[start] == pytest.approx(even[start] / math.sqrt(1.2))


def test_a_drive_with_an_integral_certifies_no_uneven_hold_and_the_check_says_so() -> None:
    overrides = ("axes.0.admittance.mode=position", "passivity.integral_gain=6600", "passivity.sync_jitter=1 %")
    assert any(hint.exceeded and "integral" in hint.text for hint in hints_of(load_scene(SCENE, overrides)))
    assert _run(*overrides, cycles=300)[0]["ports"]["handle"]["certificate"] == "none"


@pytest.mark.slow
def test_the_account_is_a_lower_bound_of_the_energy_at_the_sensor() -> None:
    with build(load_scene(SCENE)) as experiment:
        cycle = experiment.cycle
        run(cycle, 1500)
        ledger, judge = cycle.ledgers[0], cycle.judge
        assert judge is not None
        assert ledger.interaction <= judge.interaction[0] + 1e-9


@pytest.mark.slow
def test_a_guard_that_acts_makes_the_mass_heavier_and_every_reader_says_so(tmp_path, capsys) -> None:
    """Felt is at least M + c T (delay + n) / 2, by the guide to admittance displays."""
    log, bus_log = tmp_path / "run.h5", tmp_path / "run.log"
    words = ["--set", "environment.mass=0.5", "--set", "duration=1", "--log", str(log), "--bus-log", str(bus_log)]
    assert main(["run", str(SCENE), *words, "--json"]) == 0
    mass = json.loads(capsys.readouterr().out)["ports"]["handle"]["mass"]
    assert (mass["requested"], mass["share"]) == (0.5, pytest.approx(mass["felt"] / 0.5))
    assert 1.2 < mass["felt"] < 1.8
    assert main(["inspect", str(log), "--bus-log", str(bus_log), "--json"]) == 0
    inspected = json.loads(capsys.readouterr().out)
    assert inspected["ports"]["handle"]["mass"] == pytest.approx(mass, rel=1e-12)
    assert inspected["rederived"]["ports"]["handle"]["mass"] == pytest.approx(mass, rel=1e-12)
    assert main(["inspect", str(log)]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert f" · mass felt {100 * mass['share']:.3g} % of requested" in shown
    assert f"mass felt {mass['felt']:.3g} kg, {100 * mass['share']:.3g} % of requested" in shown


@pytest.mark.slow
def test_two_displays_on_a_path_have_one_account_and_every_reader_agrees(tmp_path, capsys) -> None:
    scene, log, bus_log = str(SCENE.with_name("guided_path.yaml")), tmp_path / "path.h5", tmp_path / "path.log"
    overrides = ["--set", "duration=2.6"]
    words = ["--json", "--log", str(log), "--bus-log", str(bus_log)]
    assert main(["run", scene, *overrides, *words]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["ports"]["stage"]["passive"] != "no"
    assert found["ports"]["stage"]["certificate"] in ("velocity_loop", "exact")
    assert found["ports"]["x"]["out"] > 0.05  # what came in along y went out along x
    assert found["truth"]["stage"]["least_interaction"] >= -1e-3
    assert main(["replay", "--quick", "--config", scene, *overrides, str(bus_log)]) == 0
    assert main(["inspect", str(log), "--recompute", "--bus-log", str(bus_log)]) == 0
    path = load_scene(Path(scene)).groups[0].network.parameters
    assert isinstance(path, PathMass)
    with EnergyLog.open(log) as read:
        places = [list(read.ports[name].read("position", 0, 1300)) for name in ("x", "y")]
    away = [
        math.hypot(*nearest((*path.points, path.points[0]), list(place)).away) for place in zip(*places, strict=True)
    ]
    assert max(away) < 4e-3
    capsys.readouterr()


def test_a_force_beyond_the_range_stops_the_rig() -> None:
    with pytest.raises(ForceRangeError, match="beyond the range"):
        _run("axes.0.admittance.force.range=5 N", "simulation.user.push=20 N")


def test_a_frozen_sensor_stops_the_rig() -> None:
    overrides = ("axes.0.admittance.force.frozen_after=20", "simulation.admittance.sensor.freeze_at=0.3 s")
    with pytest.raises(ForceFrozenError, match="same count"):
        _run(*overrides)


@pytest.mark.slow_but("*freeze_at*")
@pytest.mark.parametrize(
    "fault",
    [
        "simulation.admittance.sensor.freeze_at=0.8 s",
        "simulation.bus={drop: 1.0, direction: to_drive, ids: [0x201], during: [{begin: 0.8, duration: 5}]}",
        "simulation.drive.display.ramp=3 m/s^2",
    ],
)
def test_a_sensor_or_drive_that_contradicts_the_encoder_stops_the_rig(fault: str) -> None:
    with build(load_scene(SCENE, [fault])) as experiment:
        with pytest.raises(ForceContradictedError, match=r"encoder and commands at least .*\[FORCE_CONTRADICTED\]"):
            run(experiment.cycle, 2500)
        assert experiment.rig.stop_reason is StopReason.FORCE_CONTRADICTED


_NODE = SCENE.with_name("force_node.yaml")
_LOST = "simulation.bus={drop: 0.05, direction: to_master, ids: [0x189], during: [{begin: 0.3, duration: 5}]}"


@pytest.mark.slow
def test_a_running_impulse_of_a_node_of_its_own_survives_lost_frames(tmp_path, capsys) -> None:
    log, bus_log, overrides = tmp_path / "node.h5", tmp_path / "node.log", ["--set", "duration=1.2", "--set", _LOST]
    assert main(["run", str(_NODE), *overrides, "--json", "--log", str(log), "--bus-log", str(bus_log)]) == 0
    found = json.loads(capsys.readouterr().out)
    port, truth = found["ports"]["handle"], found["truth"]["handle"]
    assert port["longest_hold"] > 1
    assert truth["interaction"] > 0.5
    assert 0.9 * truth["interaction"] < port["in"] - port["out"] <= truth["interaction"] + 1e-9
    assert main(["replay", "--quick", "--config", str(_NODE), *overrides, str(bus_log)]) == 0
    assert main(["inspect", str(log), "--recompute", "--bus-log", str(bus_log)]) == 0
    capsys.readouterr()


@pytest.mark.slow
def test_raw_frames_of_a_sensor_are_read_as_described() -> None:
    node = "{cob_id: 0x345, first_byte: 2, bits: 16, order: big, length: 6}"
    changes = [f"axes.0.admittance.force.node={node}", "axes.0.admittance.force.sampling=point"]
    changes += ["axes.0.admittance.force.per_count=-0.02 N", "simulation.admittance.sensor.sampling=point"]
    with build(load_scene(_NODE, changes)) as experiment:
        run(experiment.cycle, 900)
        account = experiment_account(experiment, "completed", 1.0)
    assert account["truth"]["handle"]["interaction"] > 0.3
    assert account["truth"]["handle"]["least_interaction"] >= -1e-3


_OFFSET = (
    "axes.0.admittance.force.sampling=point",
    "axes.0.admittance.force.per_count=0.01 N",
    "simulation.admittance.sensor={sampling: point, offset: 4 N}",
)


@pytest.mark.slow_but("tare:?true")
@pytest.mark.parametrize("how", ["tare: true", "tare: autozero", "tare: true, real: true, device_type: 404"])
def test_a_transducer_is_tared_by_sdo_at_the_start(how: str) -> None:
    node = f"axes.0.admittance.force.node={{node_id: 9, {how}}}"
    with build(load_scene(_NODE, [*_OFFSET, node])) as experiment:
        run(experiment.cycle, 900)
        account = experiment_account(experiment, "completed", 1.0)
        first = -next(iter(experiment.rig.records)).samples[0].torque_applied
    assert account["truth"]["handle"]["least_interaction"] >= -1e-3
    assert abs(first) < 0.5
    assert experiment.rig.drives[0].unrestored[-1] == "force sensor: 0x1800:02 = 1, 255 before"


def test_a_sensor_that_shows_a_force_at_rest_ends_the_start() -> None:
    for scene, changes in ((_NODE, _OFFSET), (SCENE, ["simulation.admittance.sensor.offset=-0.2 N"])):
        with build(load_scene(scene, changes)) as experiment:
            with pytest.raises(StartError, match="force at rest") as refused:
                run(experiment.cycle, 5)
            assert "let go of the handle" in str(refused.value)
            assert experiment.plants[0]._epoch is None  # nothing was enabled


def test_a_transducer_that_does_not_answer_the_tare_ends_the_start() -> None:
    dead = "simulation.bus={drop: 1.0, direction: to_master, ids: [0x589], bring_up: true}"
    node = "axes.0.admittance.force.node={node_id: 9, tare: true}"
    with (
        build(load_scene(_NODE, [*_OFFSET, node, dead])) as experiment,
        pytest.raises(StartError, match="force sensor"),
    ):
        run(experiment.cycle, 5)


def test_a_sensor_of_another_device_type_is_refused_and_nobody_is_sent_anything_but_reads(tmp_path: Path) -> None:
    node, log = "axes.0.admittance.force.node={node_id: 9, device_type: 401}", tmp_path / "bus.log"
    scene = load_scene(_NODE, [*_OFFSET, node])
    with build(scene, None, None, log) as experiment, pytest.raises(StartError) as refused:
        run(experiment.cycle, 5)
    sent = [line.split()[2] for line in log.read_text().splitlines() if line.endswith(" T")]
    assert {frame[:6] for frame in sent} == {"601#40", "609#40"}
    assert "force sensor: got 0x1000 has the low word 404, expected 401" in str(refused.value)


@pytest.mark.parametrize("order", ["little", "big"])
@given(value=st.floats(width=32, allow_nan=False), first=st.integers(0, 4))
def test_a_real32_comes_out_of_its_frame_as_it_went_in(order: Literal["little", "big"], value: float, first: int):
    node = ForceNode(node_id=9, real=True, order=order, first_byte=first)
    frame = node.frame_of(value)
    assert frame[first:] == struct.pack(("<" if order == "little" else ">") + "f", value)
    assert node.value_in(bytearray(frame)) == value


def test_a_real32_that_is_no_number_is_no_force() -> None:
    sensor = {"node": ForceNode(node_id=9, real=True), "per_count": 1.0, "range": 10.0, "slew": 1.0, "error": 0.1}
    channel = ForceChannel(ForceParameters(**sensor), 1e-3)
    channel.take(float("nan"))  # type: ignore[arg-type]
    assert channel.is_wrong
    assert channel.is_beyond_range


@pytest.mark.parametrize(
    ("begin", "error", "words"),
    [
        ("bring_up: true", StartError, "frame 0x189 of the force sensor"),
        ("during: [{begin: 0.2, duration: 5}]", LinkError, "TPDO_LOST"),
    ],
)
def test_a_sensor_node_that_is_dead_stops_the_rig(begin: str, error: type[Exception], words: str) -> None:
    dead = f"simulation.bus={{drop: 1.0, direction: to_master, ids: [0x189], {begin}}}"
    with build(load_scene(_NODE, [dead])) as experiment, pytest.raises(error, match=words):
        run(experiment.cycle, 500)


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("axes.0.admittance.force.object=0x2205.1", "either object .* or node"),
        ("axes.0.admittance.force.node={bits: 16}", "neither node_id nor cob_id"),
        ("axes.0.admittance.force.node={cob_id: 0x300, first_byte: 6}", "the value ends at byte 10"),
        ("axes.0.admittance.force.node={cob_id: 0x300, tare: true}", "tare: got true without node_id"),
        ("axes.0.admittance.force.node={node_id: 9, tare: true}", "a sum has no zero"),
        ("axes.0.admittance.force.node={node_id: 9, real: true}", "a sum wraps, as integers do"),
        ("axes.0.admittance.force.node={node_id: 9, real: true, bits: 16}", "expected bits: 32"),
    ],
)
def test_a_force_sensor_has_one_source_and_a_place_in_its_frame(override: str, words: str) -> None:
    with pytest.raises(SceneError, match=words):
        load_scene(_NODE, [override])


def test_a_ramp_in_the_drive_slows_the_velocity_demanded() -> None:
    demanded: list[float] = []
    with build(load_scene(SCENE, ["simulation.drive.display.ramp=1 m/s^2"])) as experiment:
        assert experiment.far_side is not None
        drive = experiment.far_side.drives[0]
        profile, most = drive.store.entry(0x6083, 0x07), drive.store.entry(0x60C5, 0x07)

        def look(_cycles: int) -> None:
            demanded.append(drive.servo.torque)
            if len(demanded) == 200:
                assert profile.value == most.value == 0xFFFF_FFFF  # the start writes those that it can reach
                profile.value, most.value = 0, 100_000  # counts/s^2; the one at 0 limits nothing, the other does

        run(experiment.cycle, 300, progress=look)
    commands = [record.torques_per_mille[0] * 1e-6 for record in experiment.rig.records]
    steps = [abs(b - a) for a, b in pairwise(demanded)]
    assert max(steps) <= 1e-3 + 1e-12
    assert max(steps[200:]) == pytest.approx(1e-4)
    assert max(abs(b - a) for a, b in pairwise(commands)) > 3e-3


@pytest.mark.parametrize("mode", ["velocity", "position"])
def test_a_limit_written_inside_a_hold_leaves_its_velocity(mode: str) -> None:
    velocities: list[tuple[float, float]] = []
    with build(load_scene(SCENE, [f"axes.0.admittance.mode={mode}"])) as experiment:
        assert experiment.far_side is not None
        [drive] = experiment.far_side.drives

        def write(_cycles: int) -> None:
            before, limit = drive.servo.torque, drive.store.find(0x6072)
            assert limit is not None
            assert drive.store.write(0x6072, 0, limit.number.to_bytes(2, "little")) is None
            velocities.append((before, drive.servo.torque))

        run(experiment.cycle, 100, progress=write)
    assert any(before for before, _ in velocities)
    assert all(before == after for before, after in velocities)


_FRICTION = ("passivity.drive_friction=0.5 N", "passivity.drive_damping=2.2 N*s/m")


@pytest.mark.slow
@pytest.mark.parametrize("offset", [5.0, -5.0])
def test_an_offset_that_comes_in_a_run_is_found_where_the_friction_is_declared(offset: float) -> None:
    sensor = [f"simulation.admittance.sensor.{key}" for key in ("fault_at=0.5", f"fault_offset={offset}")]
    with build(load_scene(SCENE, [*sensor, *_FRICTION])) as experiment:
        with pytest.raises(ForceContradictedError, match="on average"):
            run(experiment.cycle, 1200)
        assert 500 < experiment.cycle.cycles < 1100
        assert experiment.rig.stop_reason is StopReason.FORCE_CONTRADICTED
    with build(load_scene(SCENE, _FRICTION)) as experiment:
        run(experiment.cycle, 900)  # the same without the offset


@pytest.mark.slow
def test_each_axis_of_a_group_says_that_its_sensor_contradicts_its_encoder() -> None:
    scene = SCENE.with_name("guided_path.yaml")
    with build(load_scene(scene, ["simulation.admittance.sensor.gain=0.1"])) as experiment:
        with pytest.raises(ForceContradictedError, match="motor axis 1: by its forces at most"):
            run(experiment.cycle, 300)
        assert experiment.rig.stop_reason is StopReason.FORCE_CONTRADICTED
    declared = [f"groups.0.{text}" for text in _FRICTION]
    sensor = [f"simulation.admittance.sensor.{key}" for key in ("fault_at=0.3", "fault_offset=20")]
    wrong = pytest.raises(ForceContradictedError, match=r"motor axis \d: it shows")
    with build(load_scene(scene, [*declared, *sensor])) as experiment, wrong:
        run(experiment.cycle, 400)
    with build(load_scene(scene, declared)) as experiment:
        run(experiment.cycle, 400)


def test_the_stop_is_a_quick_stop_until_standstill() -> None:
    _, experiment = _run(cycles=200)
    drive = experiment.far_side.drives[0] if experiment.far_side else None
    assert drive is not None
    assert abs(drive.servo.motor.velocity) <= 5e-3
    assert drive.state is DriveState.SWITCH_ON_DISABLED


def test_the_json_of_a_run_names_the_port(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(SCENE), "--set", "duration=0.1", "--json"]) == 0
    port = json.loads(capsys.readouterr().out)["ports"]["handle"]
    assert port["energy_allowance"] == 1e-3
    assert (port["passive"], port["verdict"]) == ("yes", "yes")  # within the allowance


@pytest.mark.slow
@pytest.mark.parametrize("name", ["wall", "two_axes", "cup_and_ball", "six_axes"])
def test_every_shipped_display_keeps_its_promise(name: str) -> None:
    scene = load_scene(SCENE.with_name(f"{name}.yaml"))
    with build(scene) as experiment:
        run(experiment.cycle, 1200)
        account = experiment_account(experiment, "completed", 1.0)
    for axis in scene.axes:
        port, truth = account["ports"][axis.parameters.name], account["truth"][axis.parameters.name]
        allowance = getattr(axis.passivity.parameters, "energy_allowance", 0.0)
        assert port["certificate"] in ("velocity_loop", "exact")
        assert truth["least_interaction"] >= -allowance - 1e-9
        assert truth["interaction"] > 0.1


def test_a_real_drive_without_0x6072_serves_once_its_limit_is_set_with_the_tool_of_the_vendor() -> None:
    lacking = [*REAL, "axes.0.quirks=[max_torque_absent]"]
    with pytest.raises(SceneError, match="0x6072"):
        load_scene(SCENE, lacking)
    load_scene(SCENE, [*lacking, "axes.0.admittance.limit_in_drive=true"])


def test_no_real_display_runs_with_an_unknown_jitter() -> None:
    with pytest.raises(InputError, match=r"missing: handle\.passivity\.sync_jitter\. Set"):
        require_no_guesses(load_scene(SCENE, REAL))
    require_no_guesses(load_scene(SCENE, [*REAL, "passivity.sync_jitter=5 %"]))
    with pytest.raises(InputError, match=r"missing: `algorithm: unprotected` in the file itself"):  # and no jitter
        require_no_guesses(load_scene(SCENE, [*REAL, "passivity={algorithm: unprotected}"]))


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("bus.rpdo=event", "rpdo: event"),
        ("groups.0.passivity.hand_speed=1 m/s", "expected 0 without hand_stiffness"),
        ("groups.0.network.points=[[0, 0, 0], [1, 0, 0]]", "coordinates"),
        ("axes.1.admittance.force.latency=1", "latency"),
        ("groups.0.network.type=sphere", "expected one of: cup_and_ball, guided_path, virtual_mass"),
    ],
)
def test_what_several_displays_cannot_do_together_is_refused(override: str, words: str) -> None:
    with pytest.raises(SceneError, match=words):
        load_scene(SCENE.with_name("guided_path.yaml"), [override])


@pytest.mark.slow
def test_an_arm_of_two_displays_renders_a_mass_in_the_plane(capsys: pytest.CaptureFixture[str]) -> None:
    scene = SCENE.with_name("two_link_arm.yaml")
    with build(load_scene(scene)) as experiment:
        run(experiment.cycle, 1000)
        account = experiment_account(experiment, "completed", 1.0)
        places = [[sample.position for sample in record.samples] for record in experiment.rig.records]
    port, truth = account["ports"]["handle"], account["truth"]["handle"]
    assert port["certificate"] in ("velocity_loop", "exact")
    assert truth["interaction"] > 0.1
    assert truth["least_interaction"] >= -1e-3
    reach = [0.3 * math.cos(a) + 0.3 * math.cos(a + b) for a, b in places]
    assert max(reach) < 0.602  # the wall at x = 0.6 m, in task space
    assert main(["compare", str(scene), "--duration", "0.2", "--json"]) == 0
    compared = {row["algorithm"] for row in json.loads(capsys.readouterr().out)["rows"]}
    assert compared == set(DISPLAY_ALGORITHMS)


def test_check_prints_what_a_user_wants_before_the_first_touch(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(SCENE), "--json", "--set", "axes.0.admittance.force.frozen_after=50"]) == 0
    hints = {hint["what"]: hint["limit"] for hint in json.loads(capsys.readouterr().out)["stability"]}
    gain, mass, time = 660.0, 2.1, 1e-3
    assert hints["mass felt at the first move, at least"] == pytest.approx(mass + gain * time)
    assert hints["lightest mass that is passive without the guard"] == pytest.approx(mass + 1.5 * gain * time)
    assert hints["speed of the first step from rest"] == pytest.approx((4e-3 / (2.0 * gain * time)) ** 0.5)
    assert hints["force uncertainty of the account"] == pytest.approx(5e3 * time / 4.0 + 0.05)
    assert hints["least force that moves it"] == pytest.approx(3.0 * 1e-6 / time)
    assert hints["energy from a stalled master"] == pytest.approx(0.25 * gain * 0.1)
    assert hints["energy from a frozen sensor"] == pytest.approx(0.25 * gain * 0.05)
