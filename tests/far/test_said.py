"""What `check` says of a link before it runs, and when a run says that the far side limited it."""

import json
from itertools import pairwise

import pytest

from canhaptic.cli.main import main
from canhaptic.far.port import PICO
from canhaptic.far.side import FarSide, Nowhere
from canhaptic.scene.far_findings import earned_after, far_findings
from canhaptic.scene.load import load_scene
from canhaptic.scene.parts import build_far_port
from canhaptic.view.run_lines import link_lines, link_status

HAND = "configs/far_hand.yaml"
SOON = ["far.level=15 mJ", "passivity.hand_push=6"]


def figures(*changes):
    return {figure.what: figure for figure in far_findings(load_scene(HAND, changes))}


def test_check_says_reserve_time_drag_and_what_is_felt(capsys):
    assert main(["check", HAND, "--json", "--set", SOON[0], "--set", SOON[1]]) == 0
    said = {row["what"]: row["value"] for row in json.loads(capsys.readouterr().out)["far"]}
    scene = load_scene(HAND, SOON)
    assert said["reserve"] == build_far_port(scene, scene.axes[0]).reserve(6.0) > 0.0
    assert said["drag in free motion"] == pytest.approx(1000.0 * 2.0 * (2.5e-3 + 0.2e-3))
    # 0.4 of the level for a start, and half of it is kept before any is sent; earned by 4 N*s/m at 0.1 m/s
    assert earned_after(scene, scene.axes[0], 0.1)[0] == pytest.approx(0.4 * 0.015 / 0.04, rel=0.1)
    assert said["time to close"] == pytest.approx(0.9 * 0.015 / 0.04, rel=0.1)
    assert said["felt from the second touch on, at most"] == 1000.0


def test_check_says_what_is_not_known_and_what_a_model_renders(monkeypatch):
    monkeypatch.setattr("canhaptic.scene.far_findings._LONGEST", 0.05)
    found = figures("passivity.hand_push=200", "far.coupling={type: model, stiffness: 2 kN/m}")
    assert found["time to close"].value is None
    assert found["drag in free motion"].value == 0.0
    assert found["felt from the second touch on, at most"].value == 2000.0
    assert figures("simulation.far_network=null")["drag in free motion"].value == pytest.approx(1.0)  # for each ms


def test_a_torque_is_limited_by_the_far_side_until_its_energy_has_come():
    scene = load_scene(HAND)
    port = build_far_port(scene, scene.axes[0])
    state, torque = port.state, 0.0
    state.linked = state.far_ready = True
    state.blend, state.far_position = 1.0, 5e-3
    for _ in range(5):
        torque = port.step(0.0, torque).torque
    assert abs(torque) < abs(port.asked) == pytest.approx(5.0)
    assert port.is_limited
    state.request = state.booked  # nothing is asked of the other side
    assert not port.is_limited
    state.received = 0.5 / PICO
    for _ in range(30):
        torque = port.step(0.0, torque).torque
    assert torque == pytest.approx(5.0, abs=0.02)
    assert not port.is_limited


def test_a_wall_that_appears_over_a_hand_raises_the_torque_in_small_steps_and_its_damping_last():
    scene = load_scene(HAND, ["far.coupling={type: model, stiffness: 2 kN/m, damping: 8 N*s/m}"])
    port, asked, torque = build_far_port(scene, scene.axes[0]), [], 0.0
    state, step = port.state, 0.01 * port.settings.torque_limit
    state.linked = state.far_ready = True
    state.blend, state.far_side, state.received = 1.0, 1.0, 2.0 / PICO
    for hold in range(400):
        state.far_wall = -10e-3 if hold < 200 else -20e-3  # it appears 10 mm in front of a hand, and jumps
        torque = port.step(0.0, torque).torque
        asked.append(-port.asked)
    rises = [after - before for before, after in pairwise(asked)]
    assert asked[:3] == pytest.approx([0.0, step, 2 * step])
    assert max(rises) <= step + 1e-9
    assert asked[199] == pytest.approx(20.0, rel=0.01)  # at its place
    assert asked[399] > 30.0
    state.damped, state.is_led = 0.5, False
    port.step(0.0, torque)
    assert state.damped == 0.0


def test_the_screen_names_the_far_side_while_it_limits():
    scene = load_scene(HAND)
    assert scene.far is not None
    side = FarSide(scene.far, build_far_port(scene, scene.axes[0]), 0, Nowhere())
    status = link_status(side.summary).__next__
    assert "limited_by" not in status()
    side.limited += 2
    assert status().endswith("; limited_by: far")
    assert "limited_by" not in status()
    [line] = link_lines({"far": side.summary()._asdict()})
    assert "limited_by: far (torque cut in 2 cycles while its energy was lacking)" in line.plain
