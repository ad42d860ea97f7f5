"""Groups of axes over the whole CAN path: the account of the group, the part of each axis, and the truth of both."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

from canhaptic.audit.inspection import inspect
from canhaptic.audit.recompute import recompute_all, rederive
from canhaptic.control.balance import Branch
from canhaptic.control.mechanisms.five_bar import FiveBar as MastersFiveBar
from canhaptic.cycle import run
from canhaptic.errors import TpdoLostError
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.replay import replay_bus_log
from canhaptic.result import run_result
from canhaptic.scene.build import Experiment, build
from canhaptic.scene.load import load_scene
from canhaptic.sim.plant.mechanism import MechanismMotor
from tests.acceptance.group_runs import AXES, GROUP, REPOSITORY, encoder_bound, identity, logged, run_config
from tests.drive.drive_bench import TamperedBus

NO_LOSS = "simulation.bus=null"
CYCLES = 600


def lossless(name: str) -> list[str]:
    return [NO_LOSS] if name == "two_handles" else []


Whole = tuple[str, Experiment, EnergyLog]


@pytest.fixture(scope="module", params=AXES)
def whole(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Whole]:
    """One run of each scene on an ideal bus: its name, what ran, and its log."""
    with logged(request.param, CYCLES, tmp_path_factory.mktemp("whole"), lossless(request.param)) as (ran, log):
        yield request.param, ran, log


@pytest.mark.slow_but("two_handles")
def test_the_true_energy_of_the_group_never_falls_below_zero_and_the_account_closes(whole: Whole) -> None:
    name, experiment, log = whole
    judge, group = experiment.cycle.judge, log.ports[GROUP[name]]
    assert judge is not None
    assert judge.least[2] >= -1e-6
    assert np.abs(group["torque_command"]).max() > 0.05
    assert identity(group).max() <= 1e-12
    parts = sum(log.ports[axis]["h_i"] for axis in AXES[name])
    assert np.abs(parts - group["h_i"]).max() <= 1e-12 * np.abs(group["h_i"]).max()
    true = -log.truth[GROUP[name]]["motor"]
    assert true[-1] == pytest.approx(judge.interaction[2], abs=1e-15)
    assert np.array_equal(true, -sum(log.truth[axis]["motor"] for axis in AXES[name]))


@pytest.mark.slow_but("two_handles")
def test_what_is_believed_of_each_axis_and_of_the_group_is_true_within_the_encoders_bound(whole: Whole) -> None:
    name, experiment, log = whole
    judge, bounds = experiment.cycle.judge, []
    assert judge is not None
    for place, axis in enumerate(AXES[name]):
        port = log.ports[axis]
        bounds.append(encoder_bound(port, experiment.scene.axis(axis).loop.encoder_count))
        assert 0.0 < judge.believed_error[place] <= bounds[place]
        moved = np.diff(port["position"])
        assert np.array_equal(port["h_i"][1:], -port["torque_applied"][1:] * moved)
        assert set(port["branch"]) == {Branch.GROUP.value}
    assert judge.believed_error[2] <= sum(bounds)


@pytest.mark.slow_but("two_handles")
def test_the_energies_of_what_is_simulated_close_over_the_run(whole: Whole) -> None:
    name, _, log = whole
    sums = {part: log.truth[GROUP[name]][part] for part in ("motor", "user", "dissipated", "stored")}
    left = sums["motor"] + sums["user"] - sums["dissipated"] - sums["stored"]
    assert sums["user"].max() > 1e-3
    assert np.abs(left).max() < 1e-12


@pytest.mark.slow
def test_master_and_plant_agree_on_where_the_handle_is_though_neither_knows_the_other() -> None:
    experiment = run_config("five_bar_sphere", 400)
    assert experiment.far_side is not None
    motor = experiment.far_side.drives[0].servo.motor
    assert isinstance(motor, MechanismMotor)
    mechanism, group = motor.shared.mechanism, experiment.scene.groups[0]
    kinematics = group.kinematics.parameters
    assert isinstance(kinematics, MastersFiveBar)
    assert kinematics.pose(mechanism.positions).position == pytest.approx(mechanism.handle, abs=1e-14)
    assert abs(mechanism.handle[0]) > 0.01


@pytest.mark.slow
@pytest.mark.parametrize("name", AXES)
def test_log_and_frames_give_the_same_account_again_bit_for_bit(name: str, tmp_path: Path) -> None:
    energy, frames = tmp_path / "run.h5", tmp_path / "run.log"
    experiment = run_config(name, 250, energy, (), frames)
    with EnergyLog.open(energy) as log:
        found = recompute_all(log)
        assert {entry["port"] for entry in found} == {*AXES[name], GROUP[name]}
        assert all(entry["mismatch"] is None for entry in found)
        again = rederive(frames, experiment.scene, log)
        assert again["differences"] == []
        seen = inspect(log)["ports"]
        assert again["ports"][GROUP[name]]["in"] == pytest.approx(seen[GROUP[name]]["in"], rel=1e-12)
    assert replay_bus_log(frames, experiment.scene)["status"] == "identical"


@pytest.mark.slow
def test_a_recomputed_group_shows_a_row_that_was_tampered_with(tmp_path: Path) -> None:
    import h5py

    path = tmp_path / "run.h5"
    run_config("xy_box", 400, path)
    with h5py.File(path, "r+") as file:
        file["ports/y/position"][300] += 1e-6
    with EnergyLog.open(path) as log:
        mismatch = {entry["port"]: entry["mismatch"] for entry in recompute_all(log)}
    assert mismatch["y"]["cycle"] == 300
    assert mismatch["stage"]["cycle"] == 300


@pytest.mark.slow_for("overrides1*")
@pytest.mark.parametrize(
    ("overrides", "limit", "words"),
    [
        ([], "singular", "closer to a singularity"),
        (
            ["groups.0.kinematics.workspace_lower=[-0.1, 0.1]", "groups.0.kinematics.workspace_upper=[0.1, 0.325]"],
            "workspace",
            "outside its declared workspace",
        ),
    ],
)
def test_at_the_edge_and_near_a_singular_pose_there_is_no_torque_and_the_log_says_why(
    overrides: list[str], limit: str, words: str, tmp_path: Path
) -> None:
    reaching = [
        "simulation.mechanisms.0.hand.rest=[0, 0.28]",
        "simulation.mechanisms.0.hand.motion={y: {amplitude: 0.12, frequency: 1.0}}",
        "groups.0.network={type: sphere, centre: [0.0, 0.28], radius: 0.03, side: inside, stiffness: 100, damping: 1}",
    ]
    with logged("five_bar_sphere", 600, tmp_path, [*reaching, *overrides]) as (experiment, log):
        group: Any = experiment.cycle.ports[0]
        judge = experiment.cycle.judge
        assert judge is not None
        assert group.limits[limit] > 50
        assert judge.least[2] >= -1e-6
        told = [event for event in log.events if event.kind == "limit" and words in event.text]
        assert told
        assert told[0].port == "stylus"
        commands = np.hypot(log.ports["left"]["torque_command"], log.ports["right"]["torque_command"])
        first = told[0].sync_index
        assert commands[:first].max() > 0.02
        assert np.all(commands[first : first + 40] == 0.0)
        assert identity(log.ports["stylus"]).max() <= 1e-12


@pytest.mark.slow
def test_an_axis_beside_a_group_renders_as_if_it_were_alone(tmp_path: Path) -> None:
    import yaml

    alone = yaml.safe_load((REPOSITORY / "configs" / "demo.yaml").read_text())
    both = yaml.safe_load((REPOSITORY / "configs" / "two_handles.yaml").read_text())
    eds = str(REPOSITORY / "eds" / "cia402_servo.eds")
    handle = {**alone["axes"][0], "node_id": 9, "eds": eds}
    both["axes"] = [{**both["axes"][0], "eds": eds}, handle, {**both["axes"][1], "eds": eds}]
    both |= {"environment": alone["environment"], "passivity": alone["passivity"], "duration": 1.0}
    del both["simulation"]["bus"]
    both["simulation"]["drive"] = {"objects": {"0x6502": 0x200}}
    both["simulation"]["axes"]["handle"] = {"plant": alone["simulation"]["plant"], "user": alone["simulation"]["user"]}
    path = tmp_path / "both.yaml"
    path.write_text(yaml.safe_dump(both))
    accounts = []
    slower = "bus.rate=500 Hz"  # three axes do not fit one bus at 1 kHz
    demo = REPOSITORY / "configs" / "demo.yaml"
    for scene in (load_scene(path, [slower]), load_scene(demo, [slower, "axes.0.node_id=9"])):
        with build(scene, "free") as experiment:
            run(experiment.cycle, 1500)
        place = [axis.parameters.name for axis in scene.axes].index("handle")
        account = experiment.cycle.ledgers[place].summary()
        accounts.append(account._replace(branches=account.branches | {"free": 0}))  # a stop waits for the slowest axis
    assert accounts[0] == accounts[1]
    assert accounts[0].energy_in > 0.0


@pytest.mark.slow
def test_what_a_mover_supplies_is_in_the_account_and_never_in_the_truth_of_the_motors(tmp_path: Path) -> None:
    wall = "type: moving_wall, normal: [1.0, 0.5], offset: -0.01, amplitude: 0.03, frequency: 1.0"
    # Without a push of the hand there is no start: the account is empty, and a wall without torque supplies nothing.
    swing = "simulation.mechanisms.0.hand.motion={x: {amplitude: 0.03, frequency: 0.37}}"
    pushed = [f"groups.0.network={{{wall}, stiffness: 800, damping: 5}}", swing]
    with logged("xy_box", 3000, tmp_path, pushed) as (experiment, log):
        [group], judge = experiment.cycle.ports, experiment.cycle.judge
        assert judge is not None
        supplied = experiment.cycle.ledgers[group.row].supplied
        assert supplied > 1e-3  # the wall pushes hand and stage
        assert judge.interaction[0] + judge.interaction[1] < -1e-4  # the motors alone gave out energy
        *of_axes, accounted = (each.interaction for each in experiment.cycle.ledgers)
        assert accounted == pytest.approx(sum(of_axes) + supplied, abs=1e-12)
        assert accounted >= -1e-6
        by_mover = np.cumsum(log.ports["stage"]["h_i"] - log.ports["x"]["h_i"] - log.ports["y"]["h_i"])
        came_in = by_mover - log.truth["x"]["motor"] - log.truth["y"]["motor"]
        assert came_in.min() >= -1e-6
        assert np.abs(came_in + log.truth["stage"]["motor"]).max() <= 1e-9  # the log's port has what the mover gave too
        assert identity(log.ports["stage"]).max() <= 1e-12


@pytest.mark.slow_but("True-xy_box")
@pytest.mark.parametrize("name", ["xy_box", "two_handles"])
@pytest.mark.parametrize("loses_commands", [False, True])
def test_a_group_whose_axes_are_heard_in_turn_is_stopped(name: str, loses_commands: bool) -> None:
    """Each axis is heard at every second SYNC, and no SYNC brings a whole set: nothing is booked, nothing computed."""
    scene = load_scene(REPOSITORY / "configs" / f"{name}.yaml", lossless(name))
    syncs, begin, end = 0, 200, scene.bus.stop_cycles
    with build(scene, "free") as experiment:
        link = experiment.rig.drives[0].link
        bus = link._bus = TamperedBus(link._bus)

        def lose(message: can.Message) -> can.Message | None:
            nonlocal syncs
            syncs += message.arbitration_id == 0x080
            lost = 0x181 + syncs % 2, 0x202 - syncs % 2
            return None if syncs > begin and message.arbitration_id in lost[: 1 + loses_commands] else message

        bus.on_send = bus.on_receive = lose
        with pytest.raises(TpdoLostError, match=r"without the TPDOs of all of .*, which render together"):
            run(experiment.cycle, 1500)
        assert experiment.cycle.cycles <= begin + end
        assert experiment.far_side is not None
        assert [drive.torque for drive in experiment.far_side.drives] == [0.0, 0.0]
        result = run_result(experiment.cycle, status="", config_hash="", method="")
        assert result["passive"] == "in doubt"
        assert result["truth"][GROUP[name]]["least_interaction"] > -0.01
        assert result["link"]["missed_tpdos"] == pytest.approx(end, abs=1)  # each SYNC lost the TPDO of one axis
