"""A program behind a rig: what it asks for is led, what it gives is what it has, and what it may not ask is refused."""

import math
from typing import Any

import numpy as np
import pytest

import canhaptic
from canhaptic.audit.recompute import recompute_all
from canhaptic.cli.long_command import notes
from canhaptic.cli.main import main
from canhaptic.errors import InputError, LinkError, SceneError
from canhaptic.far.packet import ABOVE, BELOW, Packet
from canhaptic.far.port import IDLE
from canhaptic.far.world_model import SPRING, WorldState, led_effort
from canhaptic.far.world_side import WorldAxis
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.scene.load import load_scene

SCENE = "configs/far_world.yaml"
FAST = {"far.level": "15 mJ", "simulation.user.motion.frequency": "1.5 Hz", "duration": "0.5 s"}
FAR: Any = load_scene(SCENE).far


class Wire:
    """Keeps what an axis says."""

    def __init__(self):
        self.said = []

    def say(self, packet, *, may_begin):
        self.said.append(packet)


def axis(budget=0.0):
    wire: Any = Wire()
    return WorldAxis(FAR, wire, budget, SCENE), wire.said


def test_a_world_gives_what_it_has_and_asks_for_what_it_owes():
    world, said = axis()
    world.take(Packet(0, 1, 0, 0, 0, 10**12, 0.01, 0.1, 0, 2.5))
    assert world.hand == (0.01, 0.1, 2.5)
    world.tell()
    assert said[-1].sent == 0
    world.absorbed(-0.2)  # a ball has pushed: it took 0.2 J out of the program
    assert (said[-1].sent, said[-1].wanted) == (2 * 10**11, 0)
    world.absorbed(0.5)  # the hand throws it back: half a joule is owed, but for what was sent
    assert (said[-1].sent, said[-1].wanted) == (2 * 10**11, 5 * 10**11)
    world.take(Packet(0, 2, 0, 5 * 10**11, 0, 10**12, 0.0, 0.0, 0))
    world.tell()
    assert (said[-1].sent, said[-1].received, said[-1].wanted) == (2 * 10**11, 5 * 10**11, 5 * 10**11)
    lent, said = axis(budget=0.1)
    lent.take(Packet(0, 1, 0, 0, 0, 10**12, 0.0, 0.0, 0))
    lent.free()
    assert said[-1].sent == 10**11
    lent.tell(stopping=True)
    assert said[-1].sent == 10**11


def test_what_a_world_says_is_a_model_and_never_a_torque():
    world, said = axis()
    world.wall(at=0.02, stiffness=1500.0, pushes="-", speed=-0.1, damping=3.0)
    assert (said[-1].flags & (ABOVE | BELOW), *said[-1][6:8], *said[-1][9:]) == (BELOW, 0.02, -0.1, 1500.0, 3.0)
    world.wall(0.02, 10.0, "+")
    assert said[-1].flags & (ABOVE | BELOW) == ABOVE


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda world: world.wall(0.0, 2001.0, "-"), "0 to 2000 .*far.coupling.stiffness of configs/far_world.yaml"),
        (lambda world: world.wall(0.0, 1.0, "up"), "pushes: got 'up', expected '-'"),
        (lambda world: world.wall(math.nan, 1.0, "-"), "wall: at: got nan, expected a finite number"),
        (lambda world: world.spring(0.0, 1.0, damping=21.0), "spring: damping: got 21.0, expected 0 to 20"),
        (lambda world: world.absorbed(math.inf), "absorbed: energy: got inf"),
        (lambda world: world.wall("here", 1.0, "-"), "at: got 'here'"),
    ],
)
def test_what_a_world_may_not_ask_is_refused_with_its_place_and_limit(call, text):
    with pytest.raises(InputError, match=text):
        call(axis()[0])


def rendered(words: Any, hand: Any = lambda n: 0.0, energy: float = 1.0, stiffness: float = 2000.0) -> Any:
    """Returns efforts at 1 kHz; `words` gives kind, place and speed of each hold."""
    state, efforts, before = WorldState(stiffness=stiffness, damping=5.0), [], hand(0)
    for n, (kind, at, speed) in enumerate(words):
        position = hand(n)
        velocity, before = (position - before) * 1e3, position
        efforts.append(led_effort(state, kind, at, speed, position, velocity, 1e-3, 20.0, 0.4, energy))
    return np.array(efforts), state


def test_a_wall_that_appears_jumps_turns_or_goes_changes_no_torque_in_a_step():
    words = [(0.0, 0.0, 0.0)] * 10 + [(1.0, -0.02, 0.0)] * 120 + [(1.0, -0.003, -0.3)] * 60 + [(-1.0, 0.02, 0.0)] * 120
    words += [(SPRING, -0.005, 0.2)] * 120 + [(0.0, 0.0, 0.0)] * 60
    efforts, state = rendered(words)
    assert np.abs(np.diff(efforts)).max() <= 0.4 + 1e-9
    assert efforts[9] == 0.0
    assert (efforts[129], efforts[309]) == (20.0, -20.0)  # in full, at the torque limit
    assert efforts[429] == pytest.approx(-2000.0 * 0.005)  # moved on for 50 ms, and no further
    assert efforts[-1] == state.offset == 0.0


def test_a_wall_grows_as_the_tank_pays_and_never_pulls_a_hand_that_leaves():
    poor, _ = rendered([(0.0, 0.0, 0.0)] + [(1.0, -0.02, 0.0)] * 100, energy=1e-3)
    rich, _ = rendered([(0.0, 0.0, 0.0)] + [(1.0, -0.02, 0.0)] * 100)
    assert 0.0 < poor[-1] <= math.sqrt(2.0 * 2000.0 * 1e-3) < rich[-1]
    leaving, _ = rendered([(0.0, 0.0, 0.0)] + [(1.0, -0.02, 0.0)] * 60, hand=lambda n: -1e-3 * n, energy=1e-3)
    assert leaving.min() == 0.0
    assert leaving[-1] == 0.0


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    log, turns = tmp_path_factory.mktemp("world") / "a.h5", []
    with canhaptic.World("virtual", scene=SCENE, changes=FAST, energy_log=log) as world:
        for hand in world:
            turns.append(hand["handle"])
            place = 0.02 - 0.06 * (len(turns) % 10 == 9)  # the wall jumps over the hand
            world["handle"].wall(at=place, stiffness=2000.0, pushes="-")
            if len(turns) == 22:
                world.pause(0.1)
    return world.result, log, turns


def test_a_simulated_rig_meets_a_world_that_jumps_and_stalls_and_gives_nothing_out(run):
    result, log, turns = run
    assert (result["status"], result["far"]["sessions"]) == ("completed", 1)
    assert 20 < len(turns) < 30
    assert max(hand.position for hand in turns) > 0.02
    assert result["ports"]["handle"]["verdict"] == "yes"
    assert result["truth"]["handle"]["least_interaction"] >= -1e-9
    with EnergyLog.open(log) as opened:
        torque = opened.ports["handle"]["torque_applied"]
        [found] = recompute_all(opened)
    assert (found["mismatch"], found["unchecked_rows"]) == (None, 0)
    assert torque.min() < -1.0


def test_a_program_that_hangs_takes_its_torque_with_it_and_the_iteration_ends():
    with canhaptic.World("virtual", scene=SCENE, changes={**FAST, "far.silence": "60 ms", "duration": "2 s"}) as world:
        place: Any = world._place
        for _ in world:
            world["handle"].spring(at=-0.05, stiffness=200.0)
            port = place.experiment.cycle.ports[0].controller
            if abs(port.asked) > 2.0:
                world.pause(0.065)
                assert not place.experiment.far.session.is_alive
                world.pause(0.3)
                assert (port.state.phase, port.asked, port.state.world.effort) == (IDLE, 0.0, 0.0)
    assert place.experiment.cycle.cycles < 1500
    assert world.result is not None
    assert world.result["truth"]["handle"]["least_interaction"] >= -1e-9


def test_a_world_without_its_rig_and_a_scene_without_a_world_are_refused(capsys):
    with pytest.raises(InputError, match="expected a section `far` with `world: loopback`"):
        canhaptic.World("virtual", scene="configs/far_hand.yaml")
    with canhaptic.World("loopback", scene=SCENE) as world:
        world._place.periods = lambda: 6000
        world._place.turn = lambda: None
        with pytest.raises(LinkError, match=r"no rig has answered at .*:5577 for 10 s; start it by `canhaptic run"):
            next(world)
        with pytest.raises(KeyError, match="expected 'handle'"):
            world["handel"]
    for change, text in (
        ("far.coupling.type=spring", "expected type: model"),
        ("far.peer=loopback", "expected either"),
    ):
        with pytest.raises(SceneError, match=text):
            load_scene(SCENE, [change])
    for wrong, text in (({"rig": "here"}, "World: got 'here'.*or virtual"), ({"budget": -1.0}, "budget: got -1.0")):
        with pytest.raises(InputError, match=text):
            canhaptic.World(**{"rig": "virtual", "scene": SCENE, **wrong})  # type: ignore[arg-type]
    assert "waits at 127.0.0.1:5577 for a program at 127.0.0.1:5578" in next(notes(load_scene(SCENE)))
    assert main(["run", SCENE]) == 2
    assert 'canhaptic.World("virtual")' in capsys.readouterr().err
