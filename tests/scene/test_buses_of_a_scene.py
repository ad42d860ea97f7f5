"""Several buses in one rig, from a scene: one SYNC index, each bus with its own budget, each frame with its bus."""

import json
from itertools import count, pairwise
from pathlib import Path
from typing import Any

import pytest

from canhaptic.audit.recompute import rederive
from canhaptic.cli.decode import _decode_log
from canhaptic.cycle import run
from canhaptic.drive.can.bus_cycle import CanBusCycle
from canhaptic.errors import LogFormatError, RigError, SceneError
from canhaptic.logs.bus_reader import read_bus_log
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.replay import replay_bus_log
from canhaptic.scene.build import Experiment, build
from canhaptic.scene.load import load_scene, scene_from_mapping
from canhaptic.scene.models import Scene
from canhaptic.sim.drive.profile.state_machine import DriveState
from tests.scene.scene_text import REPOSITORY

TWO_BUSES = REPOSITORY / "configs" / "two_buses.yaml"
COUNT = 1e-6  # [m]


def scene_of(axes: int, buses: int, rate: float, **further: Any) -> Scene:
    """Axes that all move differently, shared out to the buses in turn, with the same node IDs on each."""
    names = ["left", "right"][:buses]
    bus = [{"name": name} for name in names]
    bus[0]["rate"] = rate  # type: ignore[assignment]
    motion = {"amplitude": "0.1 m"}
    return scene_from_mapping(
        {
            "bus": bus,
            "axes": [
                {
                    "name": f"axis{n}",
                    "bus": names[n % buses],
                    "node_id": 1 + n // buses,
                    "eds": str(REPOSITORY / "eds" / "cia402_servo.eds"),
                    "unit": "m",
                    "counts_per_unit": 1 / COUNT,
                    "rated_torque": 10.0,
                    "torque_limit": 20.0,
                }
                for n in range(axes)
            ],
            "environment": {"type": "spring_damper_wall", "stiffness": 100.0, "damping": 2.0},
            "passivity": {"algorithm": "internal_dissipation"},
            "simulation": {
                "drive": {"objects": {"0x6502": 0x200}},
                "plant": {"mass": 0.25, "damping": 0.1},
                "user": {"stiffness": 60.0, "damping": 5.0},
                "axes": {f"axis{n}": {"user": {"motion": {**motion, "frequency": 1.0 + 0.3 * n}}} for n in range(axes)},
                **further,
            },
        }
    )


@pytest.mark.slow_but("2-1-1000.0", "3-1-500.0")
@pytest.mark.parametrize(
    ("axes", "buses", "rate"),
    [(1, 1, 1000.0), (2, 1, 1000.0), (3, 1, 500.0), (6, 1, 400.0), (2, 2, 1000.0), (3, 2, 1000.0), (6, 2, 500.0)],
)
def test_every_axis_has_its_own_account_by_one_sync_index(axes: int, buses: int, rate: float) -> None:
    with build(scene_of(axes, buses, rate)) as experiment:
        run(experiment.cycle, round(0.6 * rate))
        cycle, rig = experiment.cycle, experiment.rig
        assert len(rig.buses) == buses
        assert all(isinstance(bus, CanBusCycle) and bus.budget.fits for bus in rig.buses)
        assert {sample.sync_index for sample in rig.records[-1].samples} == {rig.sync_index}
        assert experiment.far_side is not None
        assert {drive.state for drive in experiment.far_side.drives} == {DriveState.SWITCH_ON_DISABLED}
        assert cycle.judge is not None
        variations = _torque_variations(experiment)
        for accounted, error, variation in zip(cycle.ledgers, cycle.judge.believed_error, variations, strict=True):
            assert accounted.interaction > 0.0
            assert error <= 0.5 * COUNT * variation + 1e-12  # what the encoder can hide
        energies = [ledger.interaction for ledger in cycle.ledgers]
        assert len({round(energy, 6) for energy in energies}) == axes, "accounts of two axes are the same"


def _torque_variations(experiment: Experiment) -> list[float]:
    """Returns the sum of |changes| of each axis's torque [N], from the commands that were sent."""
    records = list(experiment.rig.records)
    variations = []
    for axis in range(len(records[0].samples)):
        torques = [0.0, *(record.torques_per_mille[axis] * 0.01 for record in records), 0.0]
        variations.append(sum(abs(b - a) for a, b in pairwise(torques)))
    return variations


def test_what_does_not_fit_one_bus_fits_two() -> None:
    with pytest.raises(
        SceneError, match=r"bus\.0\.rate: the cycle does not fit .* two buses \([0-9]+ us each; `bus` a"
    ):
        scene_of(4, 1, 1000.0)
    assert len(scene_of(4, 2, 1000.0).axes_on("right")) == 2


def test_a_host_that_stops_while_it_reads_the_second_bus_sends_no_two_syncs_in_a_burst(monkeypatch) -> None:
    with build(scene_of(4, 2, 1000.0)) as experiment:
        rig, clock = experiment.rig, experiment.clock
        rig.start()
        period, drain, sent, stops = rig.bus.sample_time_ns, rig.buses[1].drain, [0], count()

        def late() -> None:
            drain()
            if len(sent) == 6 and next(stops) == 0:
                clock.wait_until(clock.now() + 9 * period + 9 * period // 10)

        monkeypatch.setattr(rig.buses[1], "drain", late)
        for _ in range(12):
            rig.sync()
            rig.write_torques([0.0] * 4)
            sent.append(rig._pace.synced)
        gaps = [(after - before) / period for before, after in pairwise(sent[2:])]
        assert (min(gaps), max(gaps)) == (pytest.approx(1.0), pytest.approx(11.0))
        assert rig.skipped_syncs == 10


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Returns energy log and bus log of a run on two buses."""
    folder = tmp_path_factory.mktemp("two_buses")
    energy, bus = folder / "a.h5", folder / "a.log"
    with build(load_scene(TWO_BUSES, ["environment.side=above"]), energy_log=energy, bus_log=bus) as experiment:
        run(experiment.cycle, 120)
    return energy, bus


@pytest.mark.slow
def test_the_bus_log_names_the_bus_of_each_frame(recorded: tuple[Path, Path]) -> None:
    frames = list(read_bus_log(recorded[1]))
    assert {frame.channel for frame in frames} == {"left", "right"}
    for name in ("left", "right"):
        syncs = [frame for frame in frames if frame.channel == name and frame.can_id == 0x080]
        tpdos = [frame for frame in frames if frame.channel == name and frame.can_id in (0x181, 0x182)]
        assert len(syncs) > 120
        assert len(tpdos) == 2 * len(syncs)
    stamps = [[f.timestamp_ns for f in frames if f.can_id == 0x080 and f.channel == name] for name in ("left", "right")]
    assert stamps[0] == stamps[1], "SYNCs of one index at different times"
    with EnergyLog.open(recorded[0]) as log:
        assert json.loads(str(log.attributes["buses"])) == ["left", "right"]
        assert (log.attributes["left_x.bus"], log.attributes["right_y.bus"]) == ("left", "right")


@pytest.mark.slow
def test_the_frames_of_each_bus_are_decoded_for_their_own_axes(recorded: tuple[Path, Path]) -> None:
    scene = load_scene(TWO_BUSES)
    nodes = {(f["channel"], f["id"]): f["node"] for f in _decode_log(recorded[1], scene) if f["kind"] == "TPDO1"}
    assert nodes == {
        ("left", 0x181): "left_x",
        ("left", 0x182): "left_y",
        ("right", 0x181): "right_x",
        ("right", 0x182): "right_y",
    }


@pytest.mark.slow
def test_the_frames_alone_give_the_same_accounts(recorded: tuple[Path, Path]) -> None:
    scene = load_scene(TWO_BUSES, ["environment.side=above"])
    with EnergyLog.open(recorded[0]) as log:
        found = rederive(recorded[1], scene, log)
    assert found["differences"] == []
    assert found["cycles"] == 142


@pytest.mark.slow
@pytest.mark.parametrize("from_sync", [False, True])
def test_a_replay_sends_the_same_frames_on_the_same_buses(recorded: tuple[Path, Path], from_sync: bool) -> None:
    scene = load_scene(TWO_BUSES, ["environment.side=above"])
    assert replay_bus_log(recorded[1], scene, from_sync=from_sync)["status"] == "identical"


@pytest.mark.slow
def test_a_frame_that_is_sent_on_the_other_bus_is_a_difference(recorded: tuple[Path, Path], tmp_path: Path) -> None:
    lines = recorded[1].read_text().splitlines(keepends=True)
    which = next(n for n, line in enumerate(lines) if n > 400 and " right 201#" in line)
    lines[which] = lines[which].replace(" right ", " left ")
    (tmp_path / "b.log").write_text("".join(lines))
    result = replay_bus_log(tmp_path / "b.log", load_scene(TWO_BUSES, ["environment.side=above"]))
    assert result["status"] == "different"
    assert result["difference"]["number"] == which + 1
    recorded_frame, sent = result["difference"]["recorded"], result["difference"]["sent"]
    assert (recorded_frame["channel"], recorded_frame["id"]) == ("left", 0x201)
    assert (sent["channel"], sent["id"]) != ("left", 0x201)


@pytest.mark.slow
def test_a_log_of_other_buses_is_refused(recorded: tuple[Path, Path], tmp_path: Path) -> None:
    (tmp_path / "b.log").write_text(recorded[1].read_text().replace(" right ", " middle "))
    with pytest.raises(
        LogFormatError, match=r"bus 'middle', which is not a name, channel or number of a bus of .*right"
    ):
        replay_bus_log(tmp_path / "b.log", load_scene(TWO_BUSES))


@pytest.mark.slow
def test_a_log_with_the_channels_of_the_interfaces_is_understood(recorded: tuple[Path, Path], tmp_path: Path) -> None:
    text = recorded[1].read_text().replace(" left ", " can0 ").replace(" right ", " can1 ")
    (tmp_path / "b.log").write_text(text)
    channels = ["bus.left.channel=can0", "bus.right.channel=can1", "environment.side=above"]
    assert replay_bus_log(tmp_path / "b.log", load_scene(TWO_BUSES, channels))["status"] == "identical"


@pytest.mark.slow_but("left-bus_off*", "right-drop*")
@pytest.mark.parametrize(
    "effect", ["bus_off: [{begin: 50 ms, duration: 1000 s}]", "drop: 1, during: [{begin: 50 ms, duration: 1000 s}]"]
)
@pytest.mark.parametrize("lost", ["left", "right"])
def test_one_bus_lost_stops_every_axis(lost: str, effect: str) -> None:
    overrides = ["environment.side=above", f"simulation.bus={{{effect}, buses: [{lost}]}}"]
    with build(load_scene(TWO_BUSES, overrides)) as experiment:
        assert list(experiment.faulty_buses) == [lost]
        with pytest.raises(RigError):
            run(experiment.cycle, 1000)
        assert experiment.far_side is not None
        axes = experiment.scene.axes
        told = [drive for of, drive in zip(axes, experiment.far_side.drives, strict=True) if of.bus != lost]
        assert [(drive.torque, drive.state) for drive in told] == [(0.0, DriveState.SWITCH_ON_DISABLED)] * 2
        experiment.clock.wait_until(experiment.clock.now() + 200_000_000)  # its own watchdog stops what hears nothing
        for drive in experiment.far_side.drives:
            assert drive.torque == 0.0
            assert drive.state is not DriveState.OPERATION_ENABLED
        assert experiment.rig.sync_index < 80


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("axes.left_x.bus=middle", "axes.left_x.bus: got 'middle', expected one of: left, right"),
        ("axes.left_x.bus=lfet", "did you mean 'left'?"),
        ("axes.left_x.bus=null", "axes.left_x.bus: missing, expected the name of the axis's bus: one of left, right"),
        ("axes.left_x.bus=right", "which is the node_id of another axis already"),
        ("bus.1.name=left", "bus.1.name: got 'left', which is the name of another bus already"),
        ("bus.1.name=a b", "bus.1.name: got 'a b'"),
        ("bus.1.name=null", "bus.1.name"),
        ("bus.1.rate=500", "bus.1.rate: applies to all buses of the rig; give it in the first"),
        ("bus.1.chanel=x", "bus.1.chanel: unknown key; did you mean 'channel'?"),
        ("bus.1.bitrate=5", "bus.1.bitrate: got 5, expected 10000 <= bitrate <= 1e6"),
        ("bus.1.bitrate=100 kbit/s", "bus.1.rate: the cycle does not fit the bus"),
        ("bus.1.interface=socketcan", "bus.0.interface: got 'virtual' together with a bus of another interface"),
        ("bus.0=5", "bus.0: got 5, expected a mapping of name, interface, channel, ..."),
        ("bus=[]", "bus: got an empty list, expected at least one bus"),
        ("bus={rate: 1000}", "axes.0.bus: got 'left', but the scene's bus has no name; leave it out"),
        ("simulation.bus={drop: 0.1, buses: [up]}", "simulation.bus.buses: got 'up', which names no bus of the scene"),
    ],
)
def test_what_is_wrong_with_the_buses_is_told_with_its_place(override: str, expected: str) -> None:
    with pytest.raises(SceneError) as caught:
        load_scene(TWO_BUSES, [override])
    assert expected in str(caught.value)


def test_two_buses_on_one_channel_and_a_bus_without_axis_are_refused() -> None:
    with pytest.raises(SceneError, match="channel 'x' is bus 'left' already"):
        load_scene(TWO_BUSES, ["bus.0.channel=x", "bus.1.channel=x"])
    axes = ["axes.right_x.bus=left", "axes.right_y.bus=left", "axes.right_x.node_id=3", "axes.right_y.node_id=4"]
    with pytest.raises(SceneError, match=r"bus\.1\.name: no axis is on bus 'right'"):
        load_scene(TWO_BUSES, [*axes, "bus.0.rate=500"])


def test_the_resolved_configuration_is_a_scene_with_the_same_hash() -> None:
    scene = load_scene(TWO_BUSES, ["bus.1.bitrate=800 kbit/s", "bus.0.rate=500"])
    assert [bus["name"] for bus in scene.resolved()["bus"]] == ["left", "right"]
    assert scene.resolved()["axes"]["right_x"]["bus"] == "right"
    assert scene.buses[1].parameters.bitrate == 800_000
    assert scene.buses[1].parameters.rate == scene.bus.rate
    assert scene.config_hash() != load_scene(TWO_BUSES, ["bus.0.rate=500"]).config_hash()
    swapped = load_scene(
        TWO_BUSES, ["bus.1.bitrate=800 kbit/s", "bus.0.rate=500", "axes.1.bus=right", "axes.1.node_id=3"]
    )
    assert scene.config_hash() != swapped.config_hash()
