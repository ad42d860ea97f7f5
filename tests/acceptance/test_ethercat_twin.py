"""One scene on CAN and on EtherCAT: the same torques to the bit, the same energies, the same verdict."""

from dataclasses import replace
from pathlib import Path

import pytest

from canhaptic.cycle import run
from canhaptic.errors import RigError
from canhaptic.logs.ethercat_frames import datagram_text, datagrams_of, read_capture
from canhaptic.scene.build import Experiment, build
from canhaptic.scene.load import scene_from_mapping
from tools.bench.demo import CONFIG, IN_CONTACT, demo_values
from tools.on_ethercat import on_ethercat, torques_of, true_energies
from tools.truth.ethercat import ethercat_scene, outcome_of
from tools.truth.judge import account_of, judged


def torques_and_energies(experiment: Experiment, cycles: int) -> tuple[list[tuple[float, ...]], list[float]]:
    """Run a scene; return the torques of each cycle, and the true energies and the booked one at the end."""
    torques = torques_of(experiment, cycles)
    ports = account_of(experiment.cycle, "completed")["ports"].values()
    booked = [port[key] or 0.0 for port in ports for key in ("stored", "dissipated", "generated")]
    return torques, [*true_energies(experiment), *booked]


@pytest.mark.parametrize("cycles", [400, pytest.param(10_000, marks=pytest.mark.slow)])
def test_a_scene_has_the_same_torques_and_energies_on_can_and_on_ethercat(cycles: int) -> None:
    values, changes = demo_values(1, 1000.0), [*IN_CONTACT, "environment.side=above"]
    scenes = (scene_from_mapping(of, str(CONFIG), changes) for of in (values, on_ethercat(values)))
    (can, can_energies), (ethercat, energies) = (torques_and_energies(build(of, "free"), cycles) for of in scenes)
    assert any(torque for (torque,) in can)
    assert can == ethercat
    assert energies == pytest.approx(can_energies, rel=0.0, abs=1e-12)


def false_claims(seeds: range) -> dict[int, tuple[str, ...]]:
    outcomes = [(seed, outcome_of(seed)) for seed in seeds]
    assert sum(of.says_yes for _, of in outcomes) > 0.2 * len(outcomes)
    is_true = [(seed, of) for seed, of in outcomes if not any(tag.startswith("false:") for tag in of.tags)]
    return {seed: of.false_claims for seed, of in is_true if of.declared and of.false_claims}


def test_a_push_against_late_torques_has_to_be_declared_on_a_line_too() -> None:
    scene = ethercat_scene(204)  # 19 N towards a wall, through its drag; 7 N are declared as it is drawn
    raised, outcome = judged(replace(scene, duration=0.04))
    assert (outcome.declared, outcome.false_claims) == (True, ())
    assert scene.passivity["hand_push"] < 19.16 < raised.passivity["hand_push"]
    assert outcome.peak > 0.0


@pytest.mark.slow
def test_random_scenes_with_drifting_clocks_and_lost_frames_claim_nothing_false() -> None:
    assert false_claims(range(80)) == {}


@pytest.mark.slow
def test_a_twin_that_assigns_four_rxpdos_starts_with_one() -> None:
    """As a Kollmorgen AKD does, whose capture refuses outputs of another length."""
    values = on_ethercat(demo_values(1, 1000.0))
    four = {"0x1C12.0": 4, "0x1C12.1": 0x1600, "0x1C12.2": 0x1601, "0x1C12.3": 0x1602, "0x1C12.4": 0x1603}
    drive = values["simulation"].setdefault("drive", {})
    drive["objects"] = {**drive.get("objects", {}), **four}
    with build(scene_from_mapping(values, str(CONFIG)), "free") as twin:
        assert twin.far_side is not None
        count = twin.far_side.drives[0].store.find(0x1C12)
        assert count is not None
        assert count.number == 4
        twin.rig.start()
        assert count.number == 1
        twin.rig.stop()
    assert count.number == 4  # as it was


@pytest.mark.slow
def test_emergencies_of_six_drives_at_once_are_all_in_the_log(tmp_path: Path) -> None:
    log = tmp_path / "six.pcap"
    scene = scene_from_mapping(on_ethercat(demo_values(6, 1000.0)), str(CONFIG))
    with build(scene, "free", bus_log=log) as experiment:
        assert experiment.far_side is not None
        drives, cycle = experiment.far_side.drives, experiment.cycle

        def fault() -> bool:
            for drive in drives if cycle.cycles == 50 else ():
                drive.inject_fault(0x7305)
            return False

        with pytest.raises(RigError, match="the drive is in FAULT at SYNC 50"):
            run(cycle, 500, fault)
    told = [(of.address, text) for _, content in read_capture(log) for of in datagrams_of(content) or ()
            if (text := datagram_text(of)).startswith("emergency 0x7305")]  # fmt: skip
    assert sorted({station for station, _ in told}) == list(range(0x1001, 0x1007))
