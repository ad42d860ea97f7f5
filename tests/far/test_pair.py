"""Two simulated rigs over a simulated network: what both plants gave, the log, and what is refused."""

import json
import shutil

import h5py
import numpy as np
import pytest

from canhaptic.audit.recompute import recompute_all
from canhaptic.audit.two_logs import course, joined
from canhaptic.cli.main import main
from canhaptic.cycle import running
from canhaptic.errors import InputError, SceneError
from canhaptic.far.port import PICO
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.program import open_rig
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from canhaptic.scene.pair import Pair

HAND, WALL = "configs/far_hand.yaml", "configs/far_wall.yaml"
SOON = ["far.level=15 mJ", "simulation.user.motion.frequency=1.5 Hz"]


def pair_of(changes=(), logs=(None, None)):
    return Pair((load_scene(HAND, [*SOON, *changes]), load_scene(WALL, ["far.level=15 mJ"])), logs)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    logs = [tmp_path_factory.mktemp("far") / name for name in ("a.h5", "a.far.h5")]
    pair = pair_of(logs=logs)
    return pair.run_through(0.6, lambda: False), logs, pair


def test_energy_crosses_and_neither_side_nor_both_give_out_what_did_not_come(run):
    outcome, _, pair = run
    assert outcome.error is None
    assert min(outcome.pair["least_true"], outcome.pair["least_true_at_handle"]) >= -1e-9
    assert min(*outcome.pair["sent"], *outcome.pair["received"]) > 1e-3
    for result, rig in zip(outcome.results, pair.rigs, strict=True):
        port, truth = result["ports"]["handle"], result["truth"]["handle"]
        assert port["verdict"] == "yes"
        assert truth["least_interaction"] >= -1e-9
        assert port["in"] - port["out"] + port["supplied"] == pytest.approx(rig.cycle.ledgers[0].interaction)
        assert port["supplied"] == pytest.approx(result["far"]["received"] - result["far"]["sent"], abs=1e-9)


def test_every_row_of_both_logs_is_recomputed_bit_for_bit(run):
    for path, scene in zip(run[1], (HAND, WALL), strict=True):
        with EnergyLog.open(path) as log:
            [found] = recompute_all(log)
            assert (found["mismatch"], found["unchecked_rows"]) == (None, 0), scene
            assert log.far is not None
            sent = log.far["sent"]
            assert (sent[1:] >= sent[:-1]).all()
            port = log.ports["handle"]
            total = PICO * (log.far["booked"][-1] - sent[-1])
            assert port["supplied"].sum() == pytest.approx(total, abs=1e-12)
            assert [event.text for event in log.events if event.kind == "far"] == ["session 1 begins"]


def test_a_port_that_counts_packets_twice_ends_its_run():
    pair = pair_of(["far.from_far={energy: 100 J, power: 10 kW}"])
    side = pair.rigs[0].far
    told = side.session.take

    def counted_twice(data, *, may_begin):
        packet = told(data, may_begin=may_begin)
        return None if packet is None else packet._replace(sent=2 * packet.sent + 10**12)

    side.session.take = counted_twice
    outcome = pair.run_through(1.5, lambda: False)
    assert outcome.results[0]["ports"]["handle"]["supplied"] > outcome.results[0]["far"]["sent"] * -1.0
    assert outcome.error is not None
    assert "sum of interaction" in str(outcome.error)


def test_a_side_that_stops_takes_the_torque_of_the_other_and_its_energy_stays():
    pair = pair_of()
    first, second = (rig.far.port.state for rig in pair.rigs)
    with running(pair.rigs[0].cycle), running(pair.rigs[1].cycle):
        for _ in range(1400):
            pair.step()
        assert first.blend == second.blend == 1.0
        sent = second.sent
        pair.rigs[0].far.stop()
        for _ in range(600):
            pair.step()
        assert second.sent in (sent, 0.0)
        assert second.blend == 0.0
        assert pair.rigs[1].cycle.rig.is_still
    pair.compare()
    pair.close()
    assert pair.least >= -1e-9


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ("far.level=10 uJ", "expected at least the reserve"),
        ("far.axis=knob", "expected the name of an axis"),
        ("far.peer=10.0.0.7:5577", "listen: missing"),
        ("simulation.far_network.delay=50 ms", "swings"),
        ("far.coupling.stiffness=-1 N/m", "stiffness"),
        ("far.silence=4 ms", "the first answer would come"),
        ("passivity={algorithm: unprotected}", "expected guarded"),
    ],
)
def test_what_a_rig_cannot_render_is_refused_with_its_key(change, text):
    with pytest.raises(SceneError, match=text):
        load_scene(HAND, [change])


def test_an_axis_of_a_group_has_no_far_side():
    far = "far={name: link, axis: x, peer: loopback, coupling: {stiffness: 100 N/m, damping: 4 N*s/m}}"
    with pytest.raises(SceneError, match=r"far\.axis: got 'x', .*there is none here; a group has no far side"):
        load_scene("configs/xy_box.yaml", [far])


@pytest.mark.slow
def test_a_link_that_was_cut_begins_anew_and_the_positions_meet_without_a_jump(tmp_path):
    path = tmp_path / "a.h5"
    outage = "simulation.far_network={delay: 2.5 ms, outage: [1.5 s, 1.8 s]}"
    outcome = pair_of([outage, "far.coupling={type: spring, stiffness: 400 N/m, damping: 8 N*s/m}"], (path, None))
    result = outcome.run_through(4.0, lambda: False)
    assert result.error is None
    assert [one["far"]["sessions"] for one in result.results] == [2, 2]
    assert result.pair["least_true"] >= -1e-9
    with EnergyLog.open(path) as log:
        torque, away = log.ports["handle"]["torque_applied"], log.ports["handle"]["position"] - log.far["position"]
        [first, cut, anew] = np.flatnonzero(np.diff(log.far["session"])) + 1
    drag = 4.0 * 0.05 * 2.0 * np.pi * 1.5  # at the hand's largest speed [N]
    assert np.abs(np.diff(torque[cut:])).max() <= drag
    assert np.abs(torque[anew - 20 : anew]).max() == 0.0 < np.abs(torque[first:cut]).max()
    assert np.abs(away[anew + 20]) > 10e-3
    assert np.abs(away[-200:]).min() < 1e-3


def test_a_rig_without_its_other_side_and_a_program_on_its_axis_are_refused():
    with pytest.raises(InputError, match="--with"):
        build(load_scene(HAND))
    with pytest.raises(InputError, match="no program may request its torques"):
        open_rig(HAND)


@pytest.mark.slow
def test_one_command_runs_both_sides_and_logs_each(tmp_path, capsys):
    log = tmp_path / "a.h5"
    assert main(["run", HAND, "--with", WALL, "--duration", "0.1", "--json", "--log", str(log)]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["pair"].keys() == {"least_true", "least_true_at_handle", "sent", "received"}
    assert (tmp_path / "a.far.h5").exists()
    assert said["far"]["sessions"] == said["with"]["far"]["sessions"] == 1


def test_two_logs_are_joined_by_their_packets_and_a_log_that_hides_energy_fails(run, tmp_path):
    first, second = run[1]
    with EnergyLog.open(first) as log, EnergyLog.open(second) as other:
        found, known = joined(log, other), course(log, other)
    assert np.nanmin(known.least) >= min(0.0, found["least"])
    assert (known.least <= known.energies[0] + known.energies[1] + 1e-15)[~np.isnan(known.least)].all()
    assert min(known.under_way) >= 0.0 < max(known.under_way)
    assert known.given_up[-1] >= known.given_up[0]
    assert (found["holds"], found["agrees"]) == (True, True)
    assert found["least"] >= -found["resolution"]
    assert 1 < found["widest"] < 40  # SYNCs in a round trip
    assert found["session"] > 0
    hidden = hiding(second, tmp_path)
    with EnergyLog.open(first) as log, EnergyLog.open(hidden) as other:
        assert not joined(log, other)["holds"]
    with h5py.File(hidden, "r+") as file:
        file["far/session"][:] += 1
    with EnergyLog.open(first) as log, EnergyLog.open(hidden) as other, pytest.raises(InputError, match="no session"):
        joined(log, other)


def hiding(path, folder):
    """Returns a copy of a log in which 1 J is given out behind the packets."""
    hidden = folder / "hidden.h5"
    shutil.copy(path, hidden)
    with h5py.File(hidden, "r+") as file:
        energy = file["ports/handle/h_i"][:]
        energy[500] -= 1.0
        file["ports/handle/h_i"][:] = energy
    return hidden


@pytest.mark.slow
def test_two_logs_of_one_link_are_judged_and_drawn_as_one_picture(run, tmp_path):
    assert main(["inspect", *map(str, run[1]), "--check", "passive"]) == 0
    assert main(["inspect", str(run[1][0]), str(hiding(run[1][1], tmp_path)), "--check", "passive"]) == 1
    picture = tmp_path / "both.svg"
    assert main(["inspect", *map(str, run[1]), "--svg", str(picture)]) == 0
    drawn = picture.read_text(encoding="utf-8")
    names = "came in at a.h5", "came in at a.far.h5", "least sum by the packets", "under way", "given up by both"
    assert all(text in drawn for text in names)


@pytest.mark.slow
def test_a_wall_that_the_other_rig_has_found_is_felt_from_the_second_touch_on_at_any_delay(tmp_path):
    network = "simulation.far_network={delay: 50 ms, jitter: 5 ms, loss: 5 %, burst: 3}"
    model = "far.coupling={type: model, stiffness: 2 kN/m, damping: 8 N*s/m}"
    changes = [network, model, "far.silence=2 s", "simulation.user.motion.amplitude=60 mm"]
    path = tmp_path / "a.h5"
    pair = Pair((load_scene(HAND, changes), load_scene(WALL, ["far.silence=2 s"])), (path, None))
    outcome = pair.run_through(7.0, lambda: False)
    assert outcome.error is None
    assert outcome.pair["least_true"] >= -1e-9
    with EnergyLog.open(path) as log:
        assert recompute_all(log)[0]["mismatch"] is None
        position, torque = log.ports["handle"]["position"], log.ports["handle"]["torque_applied"]
    late = slice(6000, 7000)
    pressed = position[late] > 0.999 * position[late].max()
    felt = (-torque[late][pressed] / (position[late][pressed] - 0.03)).mean()
    assert felt >= 1500.0  # of 2000 asked
    free = torque[3100:3900]
    assert (free**2).mean() ** 0.5 <= 0.5
