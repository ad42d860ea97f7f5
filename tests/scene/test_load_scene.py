"""Scene files that are right, and every class of fault of those that are not."""

from pathlib import Path

import pytest

from canhaptic.errors import SceneError
from canhaptic.scene.load import load_scene, scene_from_mapping, scene_from_text
from tests.scene.scene_text import SCENE, SECOND_AXIS, SHIPPED_EDS, faults, scene_file


def test_a_scene_is_read_in_si(tmp_path: Path) -> None:
    scene = load_scene(scene_file(tmp_path))
    assert scene.bus.rate == 1000.0
    assert scene.bus.sample_time_ns == 1_000_000
    assert scene.run.duration == 1.0
    [axis] = scene.axes
    assert axis.parameters.eds == SHIPPED_EDS
    assert axis.environment.name == "spring_damper_wall"
    assert axis.environment.parameters.model_dump()["stiffness"] == 100.0
    assert axis.loop.sample_time == 1e-3
    assert axis.loop.delay == 0
    assert axis.loop.encoder_count == 1e-6
    assert axis.loop.torque_quantum == 0.01
    assert axis.loop.torque_limit == 20.0
    assert axis.simulation is not None
    assert axis.simulation.drive.counts_per_unit == 1e6
    assert axis.simulation.drive.rated_torque == 10.0
    assert axis.simulation.user is not None
    assert scene.simulated


def test_a_synchronous_torque_is_one_hold_late(tmp_path: Path) -> None:
    assert load_scene(scene_file(tmp_path), ["bus.rpdo=synchronous"]).axes[0].loop.delay == 1


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("  stiffness: 100 N/m", "  stiffness: -1 N/m",
         "scene.yaml:13:14: environment.stiffness: got '-1 N/m', expected 0 <= stiffness <= 1e9 [N/m]"),
        ("  stiffness: 100 N/m", "  stiffness: 100 N*m/rad",
         "scene.yaml:13:14: environment.stiffness: got '100 N*m/rad', unit 'N*m/rad' does not fit; expected [N/m]"),
        ("  stiffness:", "  stifness:",
         "scene.yaml:13:3: environment.stifness: unknown key; did you mean 'stiffness'?"),
        ("  stiffness: 100 N/m\n", "",
         "scene.yaml:12:3: environment.stiffness: missing, expected 0 <= stiffness <= 1e9 [N/m]"),
        ("  damping: 10", "  damping: [1]",
         "scene.yaml:14:12: environment.damping: got a list, expected 0 <= damping <= 1e7 [N*s/m]"),
        ("  damping: 10", "  damping: .nan",
         "scene.yaml:14:12: environment.damping: got nan, expected 0 <= damping <= 1e7 [N*s/m]"),
        ("  damping: 10", "  damping: true", "scene.yaml:14:12: environment.damping: got true, a boolean is not"),
        ("  damping: 10", "  damping: hard",
         "scene.yaml:14:12: environment.damping: got 'hard', not a number with an optional unit; expected [N*s/m]"),
        ("spring_damper_wall", "wall",
         "scene.yaml:12:9: environment.type: unknown environment 'wall', expected one of"),
        ("  type: spring_damper_wall\n", "",
         "scene.yaml:12:3: environment.type: missing (keys given: stiffness, damping), expected one of:"),
        ("algorithm: unprotected", "algorithm: dirct",
         "scene.yaml:15:24: passivity.algorithm: unknown passivity algorithm"),
        ("algorithm: unprotected", "algorithm: 5", "scene.yaml:15:24: passivity.algorithm: got 5, expected one of:"),
        ("passivity: {algorithm: unprotected}\n", "",
         "scene.yaml:1:1: passivity: missing; give it here or in the axis"),
        ("rpdo: event", "rpdo: evnt", "scene.yaml:2:46: bus.rpdo: got 'evnt', expected 'synchronous' or 'event'"),
        ("node_id: 1", "node_id: 1.5", "scene.yaml:5:14: axes.0.node_id: got 1.5, expected 1 <= node_id <= 127"),
        ("node_id: 1", "node_id: 126", "scene.yaml:5:14: axes.0.node_id: got 126, which is the node ID of the master"),
        ("cia402_servo.eds", "none.eds", "scene.yaml:6:10: axes.0.eds: got 'none.eds', no such file in"),
        ("cia402_servo.eds", "scene.yaml", "scene.yaml:6:10: axes.0.eds: scene.yaml: lists no object"),
        ("unit: m\n", "unit: m\n    drive: eposs\n",
         "scene.yaml:8:12: axes.0.drive: got 'eposs', expected one of: copley, "),
        ("  plant:", "  effects: [{type: jelly}]\n  plant:", "simulation.effects.0.type: unknown effect 'jelly'"),
        ("  plant:", "  effects: {type: jelly}\n  plant:", "simulation.effects: got a mapping, expected a list of"),
        ("  plant:", "  effects: [5]\n  plant:", "simulation.effects.0: got 5, expected a mapping of type and"),
        ("  plant:", "  axes: {hand: {}}\n  plant:",
         "scene.yaml:17:10: simulation.axes.hand: unknown key; did you mean"),
        ("  plant:", "  drive: {objects: {x: 1}}\n  plant:", "simulation.drive.objects: 'x' names no obj"),
        ("duration: 1 s", "durations: 1 s", "scene.yaml:1:1: durations: unknown key; did you mean 'duration'?"),
        ("duration: 1 s", "log: x.h5", "scene.yaml:1:6: log: got 'x.h5', expected a mapping of keys and values"),
        ("bus: {", "bus: [] #", "scene.yaml:2:6: bus: got an empty list, expected at least one bus"),
        ("bus: {", "bus: 5 #",
         "scene.yaml:2:6: bus: got 5, expected a mapping of interface, channel and rate, or a list of"),
        ("{algorithm: unprotected}", "unprotected",
         "scene.yaml:15:12: passivity: got 'unprotected', expected a mapping of algorithm"),
    ],
)  # fmt: skip
def test_a_fault_is_shown_with_its_place_value_and_limits(tmp_path, old: str, new: str, expected: str) -> None:
    lines = faults(tmp_path, (old, new))
    assert any(expected in line for line in lines), "\n".join(lines)


@pytest.mark.parametrize("section", ["environment", "passivity", "bus", "simulation"])
def test_an_empty_section_is_a_fault_of_its_own(tmp_path: Path, section: str) -> None:
    lines = faults(tmp_path, overrides=(f"{section}={{}}",))
    assert all(line.startswith(f"--set {section}={{}}: {section}.") and "missing" in line for line in lines)


def test_all_faults_are_shown_at_once_in_the_order_of_the_file(tmp_path: Path) -> None:
    lines = faults(
        tmp_path,
        ("rate: 1 kHz", "rate: 0"),
        ("node_id: 1", "node_id: 0"),
        ("  stiffness: 100 N/m", "  stifness: 100 N/m"),
        ("mass: 0.25", "mass: -1"),
        overrides=("duration=0", "environment.side=left"),
    )
    starts = [line.split(": got")[0].split(": unknown")[0].split(": missing")[0] for line in lines]
    assert starts == [
        "--set duration=0: duration",
        "--set environment.side=left: environment.side",
        "scene.yaml:2:33: bus.rate",
        "scene.yaml:5:14: axes.0.node_id",
        "scene.yaml:12:3: environment.stiffness",
        "scene.yaml:13:3: environment.stifness",
        "scene.yaml:17:17: simulation.plant.mass",
    ]


def test_a_fault_of_a_shared_section_is_shown_once_for_all_axes(tmp_path: Path) -> None:
    second = SECOND_AXIS.replace("unit: rad", "unit: m").replace("N*m", "N")
    lines = faults(tmp_path, ("environment:\n", second + "environment:\n"), ("  damping: 10", "  damping: -10"))
    assert len(lines) == 1


def test_node_ids_and_names_are_unique(tmp_path: Path) -> None:
    second = SECOND_AXIS.replace("node_id: 2", "node_id: 1").replace("knob", "handle")
    environment = "    environment: {type: spring_damper_wall, stiffness: 1 N*m/rad}\nenvironment:\n"
    simulation = ("mass: 0.25, damping: 0.1", "mass: 0.25")
    lines = faults(tmp_path, ("environment:\n", second + environment), ("100 N/m", "100"), simulation)
    assert lines == [
        f"scene.yaml:11:11: axes.1.name: got 'handle', which is the name of another axis already "
        f"({tmp_path}/scene.yaml:4:11)".replace(f"{tmp_path}/", ""),
        "scene.yaml:12:14: axes.1.node_id: got 1, which is the node_id of another axis already (scene.yaml:5:14)",
    ]


def test_a_linear_unit_on_a_rotary_axis_is_refused(tmp_path: Path) -> None:
    lines = faults(tmp_path, ("environment:\n", SECOND_AXIS + "environment:\n"))
    assert lines == [
        "scene.yaml:20:14: environment.stiffness: got '100 N/m', unit 'N/m' does not fit; expected [N*m/rad]"
    ]


def test_a_virtual_bus_without_simulation_reaches_nobody(tmp_path: Path) -> None:
    [line] = faults(tmp_path, overrides=("simulation=null",))
    assert "bus.interface: interface 'virtual' reaches no drive outside this process" in line
    assert not load_scene(tmp_path / "scene.yaml", ["simulation=null", "bus.channel=x"]).simulated


def test_a_claimed_delay_or_sample_time_must_agree_with_the_bus(tmp_path: Path) -> None:
    overrides = ("bus.rpdo=synchronous", "passivity.delay=0", "passivity.sample_time=2 ms")
    lines = faults(tmp_path, overrides=overrides)
    assert "delays the torque by 1 hold; leave it out, or set rpdo: event" in lines[0]
    assert "bus.rate of 1000 Hz makes it 0.001 s; leave it out" in lines[1]
    assert load_scene(tmp_path / "scene.yaml", ["passivity.delay=2"]).axes[0].loop.delay == 2


def test_a_torque_that_begins_at_sync_needs_torques_that_change_at_sync(tmp_path: Path) -> None:
    [line] = faults(tmp_path, overrides=("bus.rpdo=event", "axes.0.demand_reported=after"))
    assert line.endswith("leave it out, or set rpdo: synchronous")
    assert "demand_reported: got 'after', but with bus.rpdo: event no torque changes at SYNC" in line


_SURVIVES_A_LOSS = "passivity={algorithm: guarded, hand_force: null, device_damping: 1, max_consecutive_losses: 1}"


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (("axes.0.quirks=[acts_at_once]", "bus.rpdo=synchronous"), "got 'acts_at_once' with bus.rpdo: synchronous"),
        (("axes.0.quirks=[acts_a_sync_late]", "bus.rpdo=event"), "got 'acts_a_sync_late' with bus.rpdo: event"),
        (
            ("axes.0.quirks=[acts_a_sync_late]", "bus.rpdo=synchronous", "passivity.delay=1"),
            "delays the torque by 1 hold, and its quirks by 1",
        ),
    ],
)
def test_a_drive_that_acts_in_another_hold_than_the_bus_says_is_refused(tmp_path, overrides: tuple[str, ...], words):
    [line] = faults(tmp_path, overrides=overrides)
    assert words in line


def test_no_losses_are_certified_where_a_lost_frame_showed_the_torque_of_the_next_hold(tmp_path: Path) -> None:
    lines = faults(tmp_path, overrides=(_SURVIVES_A_LOSS, "axes.0.demand_reported=after"))
    [line] = [line for line in lines if "demand_reported: got 'after' with max_consecutive_losses 1" in line]
    assert line.endswith("set max_consecutive_losses: 0")


def test_a_window_shorter_than_the_frames_is_refused_where_drives_may_be_real(tmp_path: Path) -> None:
    """47 bits for SYNC, 47 + 64 each for a TPDO and 47 + 32 for an RPDO of 4 bytes, at 1 Mbit/s; no stuff bits."""
    real = ("bus.interface=socketcan", "bus.channel=can0", "simulation=null")
    [line] = faults(tmp_path, overrides=(*real, "passivity.torque_window=100 us"))
    assert "torque_window: got 0.0001 s, but SYNC, TPDO and RPDO take 0.000237 s at least at 1e+06 bit/s" in line
    for kept in (("passivity.torque_window=240 us",), ("passivity.torque_window=0 s", "bus.rpdo=synchronous")):
        assert load_scene(tmp_path / "scene.yaml", [*real, *kept]).axes[0].loop.torque_window is not None
    assert load_scene(tmp_path / "scene.yaml", ["passivity.torque_window=0 s"]).simulated


def test_a_bus_that_is_too_slow_is_refused_with_the_arithmetic(tmp_path: Path) -> None:
    [line] = faults(tmp_path, overrides=("bus.bitrate=125 kbit/s",))
    assert line.startswith("scene.yaml:2:33: bus.rate: the cycle does not fit the bus: 1 SYNC x 55 + 1 TPDO x 135")
    assert "what fits: rate: " in line


# --- sections of an axis ------------------------------------------------------------------------------------------


def test_an_axis_lays_its_own_keys_over_the_shared_ones(tmp_path: Path) -> None:
    own = "    environment: {stiffness: 500}\n    passivity: {moving_mass: 0.2}\nenvironment:\n"
    [axis] = load_scene(scene_file(tmp_path, ("environment:\n", own))).axes
    assert axis.environment.parameters.model_dump(include={"stiffness", "damping"}) == {
        "stiffness": 500.0,
        "damping": 10.0,
    }
    assert axis.passivity.name == "unprotected"
    assert axis.loop.moving_mass == 0.2


def test_an_axis_that_names_another_type_inherits_nothing(tmp_path: Path) -> None:
    own = "    environment: {type: cushion}\nenvironment:\n"
    lines = faults(tmp_path, ("environment:\n", own))
    assert len(lines) == 1
    assert "axes.0.environment.type: unknown environment 'cushion'" in lines[0]


def test_simulation_of_an_axis_is_laid_over_the_shared_one(tmp_path: Path) -> None:
    own = "  axes:\n    handle:\n      plant: {mass: 0.5}\n      user: null\n  plant:"
    [axis] = load_scene(scene_file(tmp_path, ("  plant:", own))).axes
    assert axis.simulation is not None
    assert (axis.simulation.plant.mass, axis.simulation.plant.damping) == (0.5, 0.1)
    assert axis.simulation.user is None


def test_every_axis_has_its_own_seed(tmp_path: Path) -> None:
    second = SECOND_AXIS.replace("unit: rad", "unit: m").replace("N*m", "N")
    path = scene_file(tmp_path, ("environment:\n", second + "environment:\n"), ("  plant:", "  seed: 7\n  plant:"))
    seeds = [axis.simulation.seed for axis in load_scene(path, ["bus.rate=500"]).axes if axis.simulation]
    assert seeds == [7, 8]


# --- files --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "scene.yaml: empty, expected a mapping with bus, axes"),
        (b"# nothing\n", "scene.yaml:1:1: empty, expected a mapping with bus, axes"),
        (b"- 1\n", "scene.yaml:1:1: got a list, expected a mapping"),
        (b"hello", "scene.yaml:1:1: got 'hello', expected a mapping"),
        (b"a: [1", "scene.yaml:1:6: not valid YAML"),
        (b"x: 1\nname: caf\xe9\n", "scene.yaml:2: not UTF-8 text (byte 0xe9)"),
        ("bus: 1".encode("utf-16"), "not UTF-8 text"),
        (b"\x00\x01", "not valid YAML"),
        (b"#" * 1_000_001, "larger than 1000000 bytes"),
    ],
)
def test_a_file_that_is_no_scene_is_one_clear_error(tmp_path: Path, content: bytes, expected: str) -> None:
    path = tmp_path / "scene.yaml"
    path.write_bytes(content)
    with pytest.raises(SceneError) as caught:
        load_scene(path)
    assert expected in str(caught.value)
    assert len(caught.value.faults) == 1


def test_a_missing_file_or_a_folder_is_one_clear_error(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"cannot be read \(no such file\)"):
        load_scene(tmp_path / "none.yaml")
    with pytest.raises(SceneError, match=r"cannot be read \(is a folder\)"):
        load_scene(tmp_path)
    with pytest.raises(SceneError, match="cannot be read"):
        load_scene("a\0b")


def test_a_byte_order_mark_is_no_part_of_the_scene(tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_bytes(b"\xef\xbb\xbf" + SCENE.encode())
    assert load_scene(path).bus.rate == 1000.0


def test_the_text_that_a_log_keeps_gives_the_same_scene(tmp_path: Path) -> None:
    path = scene_file(tmp_path)
    overrides = ["environment.stiffness=300"]
    scene = load_scene(path, overrides)
    assert scene_from_text(scene.text, scene.source, scene.overrides).config_hash() == scene.config_hash()


# --- without a file -----------------------------------------------------------------------------------------------


def test_a_scene_can_be_made_of_plain_values() -> None:
    values = {
        "bus": {"interface": "virtual", "rate": 500},
        "axes": [
            {
                "name": "knob",
                "node_id": 3,
                "eds": str(SHIPPED_EDS),
                "counts_per_unit": 1000,
                "rated_torque": 1.0,
                "torque_limit": 2.0,
            }
        ],
        "environment": {"type": "spring_damper_wall", "stiffness": "1 N*m/rad"},
        "passivity": {"algorithm": "unprotected"},
        "simulation": {"plant": {"mass": 1e-3}},
    }
    assert scene_from_mapping(values).axes[0].parameters.unit == "rad"
    values["bus"] = {"rate": -1}
    with pytest.raises(SceneError, match=r"^scene: bus.rate: got -1, expected 1 <= rate <= 20000 \[Hz\]$"):
        scene_from_mapping(values)


# --- the configuration in effect ----------------------------------------------------------------------------------


def test_the_hash_ignores_comments_order_and_folder_but_no_value(tmp_path: Path) -> None:
    path = scene_file(tmp_path)
    first = load_scene(path).config_hash()
    path.write_text("# a comment\n" + "duration: 1000 ms\n" + SCENE.replace("duration: 1 s\n", ""), encoding="utf-8")
    (tmp_path / "cia402_servo.eds").write_bytes(SHIPPED_EDS.read_bytes())
    assert load_scene(path, ["log.energy=x.h5"]).config_hash() == first
    assert load_scene(path, ["environment.damping=11"]).config_hash() != first
    (tmp_path / "cia402_servo.eds").write_bytes(SHIPPED_EDS.read_bytes() + b"\n; another file\n")
    assert load_scene(path).config_hash() != first


_DEMO = Path(__file__).resolve().parents[2] / "configs" / "demo.yaml"


@pytest.mark.parametrize("key", ["torque_window", "current_lag"])
def test_no_real_drive_runs_on_a_torque_that_is_declared_never_late(key: str) -> None:
    """No frame shows how late a torque acts; in simulation 0 is what it says, and hardware still asks for the value."""
    real = ("bus.interface=socketcan", "bus.channel=can0", "simulation=null", "bus.rpdo=synchronous")
    guarded = "{algorithm: guarded, moving_mass: 0.2, hand_force: 1, sync_jitter: 0.01, device_friction_bound: 0.1, "
    for value, is_open in (("0", True), ("20 us", False)):
        loop = (
            f"passivity={guarded}device_damping_bound: 0.1, torque_window: 10 us, current_lag: 10 us, {key}: {value}}}"
        )
        loop = loop.replace(f"{key}: 10 us, ", "", 1)
        scene = load_scene(_DEMO, [*real, loop])
        assert (f"{scene.axes[0].parameters.name}.passivity.{key}" in scene.undeclared) is is_open
        assert getattr(scene.axes[0].loop, key) > 0.0
    assert getattr(load_scene(_DEMO, [f"passivity={guarded}{key}: 0}}"]).axes[0].loop, key) == 0.0
