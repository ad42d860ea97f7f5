"""A recorded hand: its table is read with its units, and the plant follows its straight lines exactly."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from canhaptic.errors import ParameterError, SceneError
from canhaptic.scene.load import load_scene
from canhaptic.scene.method import dear_holds
from canhaptic.scene.models import Scene
from canhaptic.sim.plant.effects.coulomb_friction import CoulombFriction
from canhaptic.sim.plant.effects.current_loop import CurrentLoop
from canhaptic.sim.plant.plant import Plant, PlantParameters
from canhaptic.sim.plant.user import RecordedMotion, SinusoidMotion, UserParameters

DEMO = Path(__file__).resolve().parents[2] / "configs" / "demo.yaml"
T_NS = 1_000_000
MASS = PlantParameters(mass=0.2, damping=0.3)


def _table(folder: Path, text: str) -> str:
    (folder / "hand.csv").write_text(text, encoding="utf-8")
    return str(folder / "hand.csv")


def _scene(folder: Path, text: str, *overrides: str) -> Scene:
    motion = f"simulation.user.motion={{type: recorded, file: {_table(folder, text)}}}"
    return load_scene(DEMO, [motion, *overrides])


def test_a_finely_recorded_sinusoid_moves_the_plant_as_the_sinusoid_itself(tmp_path: Path) -> None:
    whole = SinusoidMotion(amplitude=0.05, frequency=2.0)
    rows = "\n".join(f"{k * 1e-3!r},{1e3 * whole.position(k * 1e-3)!r}" for k in range(601))
    recorded = RecordedMotion(file=_table(tmp_path, f"time,position [mm]\n{rows}"))
    hands = [UserParameters(stiffness=300.0, damping=2.0, motion=motion) for motion in (whole, recorded)]
    effects: list[Any] = [CurrentLoop(time_constant=3e-4), CoulombFriction(kinetic=0.5, static=0.6)]
    ideal, followed = (Plant(MASS, hand, effects, T_NS).run(np.full(600, 0.3)) for hand in hands)
    assert np.abs(ideal - followed).max() < 1e-6 < np.ptp(ideal)
    assert (recorded.end, recorded.amplitude, recorded.offset) == pytest.approx((0.6, 0.05, 0.0), abs=1e-6)


def test_energy_is_kept_where_the_speed_of_the_hand_jumps() -> None:
    motion = RecordedMotion.model_construct(type="recorded", file=Path("hand.csv"))
    motion._rows = ((0.0, 0.0), (0.0101, 0.02), (0.0234, -0.03), (0.05, 0.0))
    plant = Plant(MASS, UserParameters.model_construct(stiffness=500.0, damping=3.0, motion=motion), [], T_NS)
    plant.run(np.zeros(100))
    energy = plant.energy()
    assert energy.motor + energy.user - energy.dissipated == pytest.approx(energy.stored, abs=1e-14)
    assert energy.user > 1e-4
    plant.reset()
    assert np.array_equal(plant.run(np.zeros(100))[-1:], [plant.position])


def test_units_stand_in_the_heading_and_time_counts_from_the_first_row(tmp_path: Path) -> None:
    text = "clock,Time (ms),handle.position [cm]\n7,500,1\n8,600,3\n"
    motion = RecordedMotion(file=_table(tmp_path, text))
    assert np.array(motion.rows) == pytest.approx(np.array([[0.0, 0.01], [0.1, 0.03]]))
    assert [motion.position(t) for t in (0.0, 0.05, 0.1, 9.0)] == pytest.approx([0.01, 0.02, 0.03, 0.03])


@pytest.mark.parametrize(
    ("text", "column"),
    {
        "semicolons": ("time [ms];position [mm]\n0;10,5\n100;30\n", "position"),
        "tabs": ("time\tposition\n0\t0.0105\n0.1\t0.03\n", "position"),
        "no heading": ("0,0.0105\n0.1,0.03\n", "position"),
        "no heading, with a unit": ("0;10,5\n0,1;30\n", "position [mm]"),
        "other names": ("t,x\n0,10.5\n0.1,30\n", "x [mm]"),
        "of a camera": ("frame,timestamp,y,x\n1,5,9,1.05\n2,5.1,9,3\n", "x [cm]"),
    }.values(),
)
def test_a_table_of_another_program_is_read(tmp_path: Path, text: str, column: str) -> None:
    motion = RecordedMotion(file=_table(tmp_path, text), column=column)
    assert np.array(motion.rows) == pytest.approx(np.array([[0.0, 0.0105], [0.1, 0.03]]))


@pytest.mark.parametrize(
    ("heading", "options"),
    [
        ("t;x", {"time_column": "t [ms]", "column": "x"}),
        ("clock;x", {"time_column": "clock [ms]", "column": "x"}),
        ("Zeit [ms];position", {"time_column": "Zeit"}),
        ("t (ms);x", {"column": "x"}),
        ("", {"time_column": "t [ms]"}),
        ("frame;position", {"time_column": "frame [1 ms]"}),
    ],
)
def test_a_column_and_the_unit_of_the_time_can_be_named(tmp_path: Path, heading: str, options: dict[str, str]) -> None:
    rows = "".join(f"{8.0 * n};{0.001 * n}\n" for n in range(40))
    motion = RecordedMotion(file=_table(tmp_path, f"{heading}\n{rows}".lstrip()), **options)
    assert motion.rows[1] == pytest.approx((0.008, 0.001))
    assert motion.end == pytest.approx(0.312)


def test_milliseconds_without_a_unit_are_refused_and_seconds_of_keyframes_are_not(tmp_path: Path) -> None:
    rows = [f"{8 * n};{0.001 * n}\n" for n in range(40)]
    with pytest.raises(SceneError, match=r"column 't': got steps of 8 without .* as time_column: t \[ms\]"):
        _scene(tmp_path, f"t;position\n{''.join(rows)}")
    assert RecordedMotion(file=_table(tmp_path, f"t;position\n{''.join(rows[:9])}")).end == 64.0
    assert RecordedMotion(file=_table(tmp_path, f"t [s];position\n{''.join(rows)}")).end == 312.0


@pytest.mark.parametrize(
    ("text", "says"),
    {
        "no time": ("frame,position\n0,1\n1,2\n", "the heading has: frame, position; name another by `time_column`"),
        "no column": ("time,place\n0,1\n1,2\n", "the heading has: time, place; name another by `column`"),
        "both points": ("time;position\n0;0.5\n1;1,5\n", "line 3: got '1;1,5', expected numbers"),
        "two columns": ("time,a.position,b.position\n0,1,1\n1,2,2\n", "a.position, b.position: name one by `column`"),
        "a word": ("time,position\n0,1\n1,x\n", "line 3: got '1,x', expected numbers"),
        "back in time": ("time,position\n1,0\n0.5,1\n", "line 3: got time 0.5 s, expected one after 1 s"),
        "far": ("time,position\n0,0\n1,2000\n", "line 3: got 2000 at 1 s, expected at most 1000"),
        "one row": ("time,position\n0,1\n", "got 1 rows of numbers, expected at least 2"),
        "another unit": ("time,position [N]\n0,1\n1,2\n", "unit 'N' does not fit"),
        "nothing": ("", "the heading has: nothing"),
    }.values(),
)
def test_a_table_that_is_none_is_one_error(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(SceneError) as caught:
        _scene(tmp_path, text)
    assert says in str(caught.value)
    assert "simulation.user.motion" in str(caught.value)


def test_an_angle_is_refused_on_a_linear_axis_and_the_file_is_found_next_to_the_scene(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="unit 'deg' does not fit"):
        _scene(tmp_path, "time,position [deg]\n0,0\n1,1\n")
    text = DEMO.read_text().replace(
        "{type: sinusoid, amplitude: 0.15 m, frequency: 0.5 Hz}", "{type: recorded, file: hand.csv}"
    )
    (tmp_path / "scene.yaml").write_text(text)
    (tmp_path / "hand.csv").unlink()
    with pytest.raises(SceneError, match=r"hand\.csv: cannot be read \(no such file\)") as caught:
        load_scene(tmp_path / "scene.yaml")
    tried = f"tried {tmp_path} and {Path.cwd()}; put the table into the current folder, or give its whole path"
    assert str(caught.value).endswith(tried)
    _table(tmp_path, "time,position\n0,0\n1.5,0.1\n")
    [note] = dear_holds(load_scene(tmp_path / "scene.yaml"))
    assert note == "handle: hand.csv ends after 1.5 s; the hand then stays at 0.1 m"
    assert dear_holds(load_scene(tmp_path / "scene.yaml", ["duration=1.5 s"])) == []


def test_millimetres_without_a_unit_are_found_by_their_speed(tmp_path: Path) -> None:
    [note] = dear_holds(_scene(tmp_path, "time,position\n0,0\n0.1,1\n20,2\n", "axes.handle.speed_limit=5 m/s"))
    assert note.startswith("handle: hand.csv, column position: moves 1 m from one row to the next at 0 s, 10 m/s, fast")
    assert note.endswith("limit of the axis, 5 m/s; without a unit in the heading a position is in m: write it as in "
                         "position [mm]")  # fmt: skip
    assert dear_holds(_scene(tmp_path, "time,position [mm]\n0,0\n0.1,1\n20,2\n", "axes.handle.speed_limit=5 m/s")) == []


def test_the_measured_position_of_a_simulated_log_goes_before_the_true_one(tmp_path: Path) -> None:
    both = "time,handle.position,true.handle.position\n0,1,5\n1,2,6\n"
    assert RecordedMotion(file=_table(tmp_path, both)).rows == ((0.0, 1.0), (1.0, 2.0))
    true = RecordedMotion(file=_table(tmp_path, both), column="true.handle.position")
    assert true.rows == ((0.0, 5.0), (1.0, 6.0))


def test_the_configuration_knows_the_content_of_the_table_and_not_its_folder(tmp_path: Path) -> None:
    found = []
    for folder, row in (("a", "1,0.1"), ("b", "1,0.1"), ("c", "1,0.2")):
        (tmp_path / folder).mkdir()
        found.append(_scene(tmp_path / folder, f"time,position\n0,0\n{row}\n").config_hash())
    assert found[0] == found[1] != found[2]


def test_a_motion_of_another_type_names_the_two(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="got 'record', expected one of: sinusoid, recorded"):
        load_scene(DEMO, ["simulation.user.motion.type=record"])
    with pytest.raises(ParameterError, match="motion without a hand"):
        UserParameters(motion=RecordedMotion(file=_table(tmp_path, "time,position\n0,0\n1,1\n")))
