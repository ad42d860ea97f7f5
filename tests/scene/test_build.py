"""A scene built: clock, buses, drives, controllers and logs fit together, and everything is closed again."""

import gc
import json
import socket
from pathlib import Path

import pytest

from canhaptic.cycle import run
from canhaptic.drive.axis_parameters import CanBusParameters
from canhaptic.drive.can.door import open_bus, private_channel
from canhaptic.drive.clock import VirtualClock, WallClock
from canhaptic.errors import InputError, LinkError, ParameterError, RigError
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.scene.build import build, require_buildable
from canhaptic.scene.buses import can_bus
from canhaptic.scene.far_side import build_far_end
from canhaptic.scene.hints import stability_hints
from canhaptic.scene.load import load_scene
from canhaptic.scene.method import method_line
from tests.scene.scene_text import SECOND_AXIS, scene_file


def test_a_simulated_scene_runs_in_lock_step_unless_told_otherwise(tmp_path: Path) -> None:
    scene = load_scene(scene_file(tmp_path))
    with build(scene) as free, build(scene, "real") as real:
        assert (free.pace, real.pace) == ("free", "real")
        assert isinstance(free.clock, VirtualClock)
        assert isinstance(real.clock, WallClock)


def test_free_pace_needs_simulated_drives(tmp_path: Path) -> None:
    scene = load_scene(scene_file(tmp_path), ["simulation=null", "bus.channel=elsewhere"])
    with pytest.raises(InputError, match="pace 'free' needs drives simulated in this process"):
        build(scene, "free")
    with build(scene) as experiment:
        assert experiment.pace == "real"
        assert experiment.far_side is None


def test_two_experiments_do_not_share_a_bus(tmp_path: Path) -> None:
    assert private_channel() != private_channel()
    scene = load_scene(scene_file(tmp_path))
    with build(scene) as first, build(scene) as second:
        run(first.cycle, cycles=20)
        run(second.cycle, cycles=20)
        assert [each.rig.link_statistics()["foreign"] for each in (first, second)] == [0, 0]


@pytest.mark.slow
def test_a_run_leaves_nothing_behind(tmp_path: Path) -> None:
    scene = load_scene(scene_file(tmp_path))
    with build(scene, energy_log=tmp_path / "a.h5", bus_log=tmp_path / "a.log") as experiment:
        run(experiment.cycle, cycles=10)
    experiment.close()  # a second time does nothing
    del experiment
    gc.collect()  # an unclosed bus or process would warn, and a warning fails the test
    assert (tmp_path / "a.log").stat().st_size > 0


def test_a_failed_build_closes_what_it_opened(tmp_path: Path) -> None:
    scene = load_scene(scene_file(tmp_path), ["simulation.drive.objects.0x5FFE=1"])
    with pytest.raises(InputError, match=r"(?i)0x5ffe"):
        build(scene, energy_log=tmp_path / "a.h5")
    gc.collect()


@pytest.mark.slow
def test_the_energy_log_tells_what_was_run(tmp_path: Path) -> None:
    path = scene_file(tmp_path)
    scene = load_scene(path, ["environment.position=-0.02"])
    with build(scene, energy_log=tmp_path / "a.h5") as experiment:
        run(experiment.cycle, cycles=50)
    with EnergyLog.open(tmp_path / "a.h5") as log:
        attributes = log.attributes
        assert (log.rows, log.status, log.sample_time_ns) == (50, "completed", 1_000_000)
        assert attributes["config"] == path.read_text()
        assert json.loads(str(attributes["config_overrides"])) == ["environment.position=-0.02"]
        assert json.loads(str(attributes["config_resolved"])) == scene.resolved()
        assert attributes["config_hash"] == scene.config_hash()
        assert attributes["handle.eds_hash"] == scene.axes[0].dictionary_hash()
        assert attributes["handle.wall_position"] == -0.02
        assert attributes["handle.wall_side"] == "below"
        assert attributes["clock_base"] == "virtual, from 0"
        assert attributes["bitrate"] == 1_000_000
        assert set(log.truth) == {"handle"}


def test_two_axes_of_different_kind_run_on_one_bus(tmp_path: Path) -> None:
    own = (
        "    environment: {type: spring_damper_wall, stiffness: 1 N*m/rad, damping: 0.01}\n"
        "    passivity: {algorithm: internal_dissipation}\n"
        "environment:\n"
    )
    simulation = (
        "simulation:\n  axes:\n    knob:\n      plant: {mass: 0.001 kg*m^2, damping: 0.001}\n"
        "      user: {stiffness: 0.5 N*m/rad, damping: 0.01, motion: {amplitude: 1 rad, frequency: 1}}\n"
    )
    path = scene_file(tmp_path, ("environment:\n", SECOND_AXIS + own), ("simulation:\n", simulation))
    scene = load_scene(path, ["bus.rate=500", "environment.side=above"])
    with build(scene) as experiment:
        run(experiment.cycle, cycles=500)
        judge = experiment.cycle.judge
        assert judge is not None
        for axis, ledger in enumerate(experiment.cycle.ledgers):
            assert ledger.summary().energy_in > 1e-4
            assert judge.believed_error[axis] < 0.01 * ledger.summary().energy_in


def test_scale_and_ratio_of_the_drive_agree_with_the_axis(tmp_path: Path) -> None:
    overrides = ["axes.0.transmission=50", "axes.0.counts_per_unit=2e5", "environment.side=above"]
    scene = load_scene(scene_file(tmp_path), overrides)
    with build(scene) as experiment:
        run(experiment.cycle, cycles=1000)
        judge = experiment.cycle.judge
        assert judge is not None
        assert abs(judge.interaction[0]) > 1e-3
        assert judge.believed_error[0] < 1e-3 * abs(judge.interaction[0]) + 1e-4


def test_a_wrong_rated_torque_is_found_at_the_start(tmp_path: Path) -> None:
    scene = load_scene(scene_file(tmp_path), ["simulation.drive.rated_torque=5 N"])
    with build(scene) as experiment, pytest.raises((RigError, InputError), match="rated"):
        run(experiment.cycle, cycles=10)


def test_a_bus_that_cannot_be_used_is_one_clear_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="bus 'telepathy', channel 'x': python-can cannot use it"):
        open_bus(CanBusParameters(interface="telepathy", rate=1000.0), "x")

    def refuse(*_: object) -> None:
        raise OSError(19, "No such device")

    scene = load_scene(scene_file(tmp_path), ["bus.interface=socketcan", "bus.channel=can9"])
    if hasattr(socket, "AF_CAN"):
        monkeypatch.setattr("can.interfaces.socketcan.socketcan.create_socket", refuse)
        with pytest.raises(LinkError, match="channel 'can9': cannot be opened"):
            build(scene)


def test_drives_cannot_be_simulated_without_a_simulation(tmp_path: Path) -> None:
    scene = load_scene(scene_file(tmp_path), ["simulation=null", "bus.channel=x"])
    with open_bus(can_bus(scene.bus), "x") as bus, pytest.raises(InputError, match="has no `simulation`"):
        build_far_end(scene, None, bus)[0]


def test_the_method_line_names_what_is_not_exact(tmp_path: Path) -> None:
    path = scene_file(tmp_path)
    assert method_line(load_scene(path)) == "plant exact between SYNCs; torque acts at its own SYNC"
    assert "one sample late" in method_line(load_scene(path, ["bus.rpdo=synchronous"]))
    assert method_line(load_scene(path, ["simulation=null", "bus.channel=x"])) == ""


def test_hints_agree_with_the_formulas_of_the_literature(tmp_path: Path) -> None:
    scene = load_scene(scene_file(tmp_path), ["passivity.moving_mass=0.5", "passivity.device_damping=0.2"])
    limits = {hint.what: hint for hint in stability_hints(scene.axes[0])}
    assert limits["stiffness, Colgate's bound 2 b / T"].limit == pytest.approx(2 * 0.2 / 1e-3)
    assert limits["damping, stable"].limit == pytest.approx(2 * 0.5 / 1e-3)
    assert limits["damping, no ripple"].limit == pytest.approx(0.343 * 0.5 / 1e-3, rel=1e-3)
    # The plant has no Coulomb friction, and 10 N*s/m of damping is more than the device has to give.
    exceeded = {what for what, hint in limits.items() if hint.exceeded}
    assert exceeded == {"stiffness, quantisation bound 2 f_c / count", "damping, Colgate's bound b - k T / 2"}
    late = load_scene(tmp_path / "scene.yaml", ["bus.rpdo=synchronous", "passivity.moving_mass=0.01"])
    limits = {hint.what: hint for hint in stability_hints(late.axes[0])}
    assert limits["damping, stable"].limit == pytest.approx(0.828 * 0.01 / 1e-3, rel=1e-3)
    assert limits["damping, stable"].exceeded


def test_what_is_not_known_is_said_to_be_unknown(tmp_path: Path) -> None:
    scene = load_scene(scene_file(tmp_path), ["simulation=null", "bus.channel=x"])
    hints = stability_hints(scene.axes[0])
    assert hints
    assert all(hint.limit is None and not hint.exceeded for hint in hints)
    assert all("declare passivity." in hint.text or "no Coulomb friction known" in hint.text for hint in hints)


def test_certified_stiffness_follows_the_hand_force(tmp_path: Path) -> None:
    overrides = [
        "passivity={algorithm: guarded, moving_mass: 0.2, device_damping_bound: 0, torque_window: 0, hand_force: 20}"
    ]
    limits = {h.what: h.limit for h in stability_hints(load_scene(scene_file(tmp_path), overrides).axes[0])}
    # (m / 2 T^2) F / (F + F_h) with F the torque limit of 20 N
    assert limits["stiffness, certified by hand force"] == pytest.approx(0.2 / 2e-6 * 20 / (20 + 20))
    speed = 20 * 1e-3 / 0.2 + 1e-6 / 1e-3  # F_h T / m, and the count that the last displacement is known to
    assert limits["slowest approach with torque in its first cycle"] == pytest.approx(speed)
    held = 0.2 / 2e-6 * 5 / (5 + 20)  # leant on with a quarter of the torque limit
    assert limits["stiffest wall held at a push of 5 N"] == pytest.approx(held)
    [stiffness] = [float(what.split()[-2]) for what in limits if what.startswith("energy to feel slower contacts")]
    lacking, whole = 0.5 / stiffness - 1e-6 / 0.2, 1e-6 / 0.2 * 20  # the most of h F (F + F_h) - F^2 / 2k
    assert limits[f"energy to feel slower contacts, {stiffness:.4g} N/m"] == pytest.approx(whole**2 / 4 / lacking)
    overrides[0] = overrides[0].replace("}", ", device_friction: 0.5, device_friction_bound: 0.5, earned_energy: 0}")
    hints = {h.what: h for h in stability_hints(load_scene(scene_file(tmp_path), overrides).axes[0])}
    assert hints["slowest approach with torque in its first cycle"].limit == 0.0
    [energy] = [hint for what, hint in hints.items() if what.startswith("energy to feel slower contacts")]
    assert energy.limit is not None
    assert f"device_friction earns it over {energy.limit / 0.5:.2g} m of any motion" in energy.text
    assert "earned_energy keeps 0 J of it" in energy.text


def test_the_quantisation_bound_needs_friction_and_takes_that_of_the_simulated_plant(tmp_path: Path) -> None:
    path, name = scene_file(tmp_path), "stiffness, quantisation bound 2 f_c / count"
    bare = {h.what: h for h in stability_hints(load_scene(path).axes[0])}[name]
    assert bare.limit == 0.0  # a plant without friction: half a count feigns energy at any stiffness
    assert bare.exceeded
    friction = "simulation.effects=[{type: coulomb_friction, kinetic: 0.02, static: 0.03}]"
    dry = {h.what: h for h in stability_hints(load_scene(path, [friction]).axes[0])}[name]
    assert dry.limit == pytest.approx(2 * 0.02 / 1e-6)
    assert "the requested wall needs 5e-05 N" in dry.text  # k count / 2 = 100 * 1e-6 / 2


def test_the_damping_that_colgate_leaves_falls_with_the_stiffness(tmp_path: Path) -> None:
    path = scene_file(tmp_path)
    for stiffness, left in ((100.0, 0.05), (1000.0, 0.0)):
        hints = stability_hints(load_scene(path, [f"environment.stiffness={stiffness}"]).axes[0])
        found = {h.what: h.limit for h in hints}["damping, Colgate's bound b - k T / 2"]
        assert found == pytest.approx(left)


def test_the_largest_certificate_says_how_much_of_the_wall_it_holds(tmp_path: Path) -> None:
    passivity = "{algorithm: guarded, moving_mass: 0.2, hand_force: 20, device_damping: 2, device_damping_bound: 2"
    passivity += ", hand_speed: 50}"
    overrides = [f"passivity={passivity}", "environment.stiffness=1e5", "bus.rpdo=synchronous"]
    hints = {h.what: h for h in stability_hints(load_scene(scene_file(tmp_path), overrides).axes[0])}
    assert hints["stiffness, certified by device damping"].limit == pytest.approx(2 * 2 / 2e-3)
    assert hints["stiffness, certified by hand speed"].limit == pytest.approx(20 / (2 * 50 * 2e-3))
    largest = max(h.limit for name, h in hints.items() if name.startswith("stiffness, certified by"))  # type: ignore[type-var]
    assert hints["stiffness, certified"].limit == largest
    assert f"covers {largest / 1e3:.3g} % of the requested stiffness" in hints["stiffness, certified"].text  # type: ignore[operator]


def test_an_environment_that_turns_needs_the_push_of_the_hand(tmp_path: Path) -> None:
    changes = [
        "environment={type: detents, peak: 2, pitch: 0.01}",
        "passivity={algorithm: guarded, moving_mass: 0.2, hand_force: 5}",
    ]
    path = scene_file(tmp_path)
    with pytest.raises(InputError, match=r"hand_push: not declared.* 'detents' has more than one exit"):
        build(load_scene(path, changes), energy_log=tmp_path / "run.h5")
    assert not (tmp_path / "run.h5").exists()
    with pytest.raises(InputError, match=r"declare it \(such as 0\.6 N, twice torque_limit\)"):
        build(load_scene(path, [*changes, "axes.0.torque_limit=0.3"]))
    with pytest.raises(InputError, match="hand_push"):
        require_buildable(load_scene(path, changes))
    for more in ("passivity.hand_push=20", "environment={type: free_space}", "environment={type: spring_damper_wall, "
                 "stiffness: 100}"):  # fmt: skip
        build(load_scene(path, [*changes, more])).close()
    by_damping = "passivity={algorithm: guarded, moving_mass: 0.2, hand_force: null, device_damping: 0.1}"
    build(load_scene(path, [changes[0], by_damping])).close()


def test_a_missing_rated_torque_is_asked_for_at_the_axis() -> None:
    with pytest.raises(ParameterError, match="of the axis: that of its motor times the transmission"):
        build(load_scene("demo", ["axes.0.rated_torque=null"]))
