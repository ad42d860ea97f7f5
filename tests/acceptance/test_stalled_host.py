"""A torque that is held longer than was certified: the account says so. `max_consecutive_losses` covers no stalls."""

import json
from pathlib import Path
from typing import Any

import pytest

from canhaptic.cli.main import main
from canhaptic.control.balance import AT_REST, Certificate
from canhaptic.control.ledger import Ledger
from canhaptic.cycle import run
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.result import withdraw_certificates
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene

DEMO = Path(__file__).resolve().parents[2] / "configs" / "demo.yaml"
STALLS = "simulation.bus={stall: [{begin: 1.15, duration: 0.06, every: 0.0713}]}"
ENDURES = ("axes.0.energy_uncertainty_limit=none", "bus.loss_limit=1")
GOES_ON = ("axes.0.energy_loss_limit=none", "bus.stop_cycles=5000", *ENDURES)  # where a rig would end the run
THROWN = (  # by a hand that has let go, at a wall
    "simulation.user=null",
    "simulation.plant={mass: 0.2 kg, damping: 0 N*s/m, initial_position: 0.02 m, initial_velocity: -0.3 m/s}",
    "environment={type: spring_damper_wall, stiffness: 1000 N/m, damping: 20 N*s/m, position: 0 m}",
)


def account(capsys: pytest.CaptureFixture[str], *values: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Returns the account of the handle and the truth."""
    words = [word for value in (*GOES_ON, *values) for word in ("--set", value)]
    main(["run", str(DEMO), "--duration", "1.7", "--json", "--set", "bus.rate=250 Hz", *words])
    result = json.loads(capsys.readouterr().out)
    return result["ports"]["handle"], result["truth"]["handle"]


def test_a_torque_that_acted_for_longer_than_was_certified_was_not(capsys: pytest.CaptureFixture[str]) -> None:
    """60 ms at 250 Hz are 15 sample times beyond the one; the energy that came out is in the account and in truth."""
    port, truth = account(capsys, STALLS)
    assert (port["longest_hold"], port["certificate"]) == (16, "none")
    assert port["least_interaction"] < -1e-3
    assert truth["least_interaction"] == pytest.approx(port["least_interaction"], rel=0.01)


@pytest.mark.slow_but("0-hand_force")
@pytest.mark.parametrize(("max_consecutive_losses", "certificate"), [(-1, "none"), (0, "hand_force")])
def test_frames_lost_are_certified_as_far_as_they_are_declared(max_consecutive_losses: int, certificate: str, capsys):
    drop = "simulation.bus={drop: 0.1}"
    before, _ = account(capsys, drop)
    longest, branches = before["longest_hold"], before["branches"]
    assert longest > 2
    assert branches["held"] > 0
    out = sum(branches[name] for name in ("free", "exit", "held"))  # a hold held on is counted with the next
    assert before["contact"]["holds"] == sum(branches.values()) - out
    port, truth = account(capsys, drop, f"passivity.max_consecutive_losses={longest - 1 + max_consecutive_losses}")
    assert port["certificate"] == certificate
    assert port["longest_hold"] <= longest  # an RPDO that is lost shows only where the torque changes
    assert port["out"] > 0.0
    if certificate != "none":
        assert truth["least_interaction"] >= -1e-9


def test_lost_frames_certify_no_sync_that_was_skipped(capsys: pytest.CaptureFixture[str]) -> None:
    """The torque under way acts for longer, and the one behind it, computed for after one hold, acts all the same."""
    stalls = "simulation.bus={stall: [{begin: 0.0528, duration: 0.058, every: 0.0713}]}"
    port, truth = account(capsys, stalls, "passivity.max_consecutive_losses=15", *THROWN)
    assert port["longest_hold"] <= 16
    assert truth["least_interaction"] < -5e-5
    assert port["certificate"] == "none"


UNEVEN = "simulation.bus={stall: [{begin: 0.2, duration: 0.04 ms, every: 0.0113}]}"


@pytest.mark.slow_for("0.039-none")
@pytest.mark.parametrize(("jitter", "certificate"), [(0.039, "none"), (0.041, "hand_force")])
def test_a_hold_longer_than_declared_has_no_certificate_and_one_that_is_not_has(jitter, certificate, capsys, tmp_path):
    """0.04 ms of 1 ms: no SYNC is skipped."""
    path = tmp_path / "run.h5"
    words = ["--duration", "0.4", "--pace", "free", "--json", "--log", str(path)]
    values = ("environment.side=above", UNEVEN, f"passivity.sync_jitter={jitter}")
    main(["run", str(DEMO), *words, *[word for value in values for word in ("--set", value)]])
    port = json.loads(capsys.readouterr().out)["ports"]["handle"]
    assert (port["longest_hold"], port["certificate"]) == (1, certificate)
    assert main(["inspect", str(path), "--recompute"]) == 0
    with EnergyLog.open(path) as log:
        assert any("sync_jitter" in event.text for event in log.events) == (certificate == "none")


@pytest.mark.slow_but("0x201")
@pytest.mark.parametrize("rpdo", ["0x201", "0x202"])
def test_of_a_group_the_axis_held_longest_counts(rpdo: str, capsys: pytest.CaptureFixture[str]) -> None:
    scene = DEMO.with_name("two_handles.yaml")
    lost = f"simulation.bus={{drop: 0.45, ids: [{rpdo}]}}"
    endures = ("bus.loss_limit=1", "axes.0.energy_uncertainty_limit=none", "axes.1.energy_uncertainty_limit=none")
    main(["run", str(scene), "--duration", "0.3", "--json", *(w for each in (lost, *endures) for w in ("--set", each))])
    ports = json.loads(capsys.readouterr().out)["ports"]
    [group] = [port for port in ports.values() if "axes" in port]
    assert group["longest_hold"] > 1 + group["max_consecutive_losses"]
    assert group["certificate"] == "none"


@pytest.mark.parametrize(("torque", "certificates"), [(1.0, ["none"]), (0.0, [])])
def test_a_long_hold_takes_the_certificates_of_torques(torque: float, certificates: list[str]) -> None:
    ledger = Ledger()
    ledger.add(AT_REST._replace(torque=torque, certificate=Certificate.HAND_FORCE.value), 0)
    account = ledger.summary().as_json(1e-3)
    account["longest_hold"], account["max_consecutive_losses"] = 2, 0
    withdraw_certificates(account, longest_gap=1)
    assert account["certificates"] == certificates


@pytest.mark.parametrize(("longest_gap", "certificate"), [(1, "hand_force"), (2, "none")])
def test_a_certificate_that_covers_lost_frames_covers_no_skipped_sync(longest_gap: int, certificate: str) -> None:
    ledger = Ledger()
    ledger.add(AT_REST._replace(torque=1.0, certificate=Certificate.HAND_FORCE.value), 0)
    account = ledger.summary().as_json(1e-3)
    account["longest_hold"], account["max_consecutive_losses"] = 2, 1
    withdraw_certificates(account, longest_gap=longest_gap)
    assert account["certificates"] == [certificate]


@pytest.mark.slow_but("0.2297")
@pytest.mark.parametrize("begin", [0.2167, 0.2232, 0.2284, 0.2297])
def test_a_stall_at_the_entry_into_a_wall_is_no_kick(begin: float, tmp_path: Path) -> None:
    """14 sample times of motion, taken for one, asked a damper of 2 N for 8 to 33 N."""
    values = [
        "simulation.user=null",
        "simulation.plant={mass: 0.2 kg, damping: 0 N*s/m, initial_position: 0.02 m, initial_velocity: -0.1 m/s}",
        "environment={type: spring_damper_wall, stiffness: 1000 N/m, damping: 20 N*s/m, position: 0 m}",
        f"simulation.bus={{stall: [{{begin: {begin}, duration: 0.014, every: 10}}]}}",
    ]
    path = tmp_path / "run.h5"
    words = [word for value in values for word in ("--set", value)]
    main(["run", str(DEMO), "--duration", "0.4", "--log", str(path), *words])
    with EnergyLog.open(path) as log:
        strongest = float(abs(log.ports["handle"]["torque_applied"]).max())
    assert 1.0 < strongest < 5.0


@pytest.mark.slow
def test_a_torque_that_was_never_commanded_voids_the_certificate(capsys: pytest.CaptureFixture[str]) -> None:
    """The drive shows the torque that begins at a SYNC, the scene takes it for the one that ended there."""
    port, _ = account(capsys, "simulation.drive.torque_read_back=after_update")
    assert port["uncommanded_cycles"] > 20
    assert (port["certificate"], port["certificates"]) == ("none", ["none"])
    main(["run", str(DEMO), "--full", "--duration", "1.7", "--set", "simulation.drive.torque_read_back=after_update"])
    assert "cycles with another torque than commanded" in capsys.readouterr().out
    port, _ = account(capsys, "simulation.drive.torque_read_back=after_update", "axes.0.demand_reported=after")
    assert (port["uncommanded_cycles"], port["certificate"]) == (0, "hand_force")


def test_no_account_of_torques_that_were_never_commanded_says_yes(capsys: pytest.CaptureFixture[str]) -> None:
    """Booked with the torque of the next hold, what a delayed damper gives out looks as if it came in."""
    wall = "environment={type: spring_damper_wall, stiffness: 100 N/m, damping: 60 N*s/m, position: -0.05 m}"
    values = ("passivity={algorithm: unprotected}", wall, "simulation.drive.torque_read_back=after_update")
    port, truth = account(capsys, *values)
    assert truth["least_interaction"] < -0.05 < 0.0 == port["least_interaction"]
    assert port["energy_resolution"] < 1e-3
    assert port["passive"] == "in doubt"


@pytest.mark.slow_but("values3")
@pytest.mark.parametrize(
    "values",
    [
        ("simulation.drive.torque_limit=1 N",),  # a smaller torque
        ("simulation.bus={drop: 0.2}", "passivity.max_consecutive_losses=12"),  # an older one
        ("bus.rpdo=event", "simulation.bus={drop: 0.2}", "passivity.max_consecutive_losses=12"),
        ("axes.0.read_back=actual", "simulation.drive.torque_lag=2 ms"),  # one that settles
    ],
)
def test_smaller_older_and_settling_torques_are_no_other_torques(values: tuple[str, ...], capsys) -> None:
    port, _ = account(capsys, *values)
    assert port["out"] > 0.0
    assert port["uncommanded_cycles"] == 0


@pytest.mark.slow
def test_a_group_takes_a_skipped_sync_for_holds_of_which_only_the_whole_motion_is_known() -> None:
    """Its wall goes on by the time that passed, and no fast motion is made of a slow one that lasted longer."""
    scene = load_scene(DEMO.parent / "two_handles.yaml", ["simulation.bus={stall: [{begin: 0.3, duration: 5 ms}]}"])
    with build(scene) as built:
        [group], missed = built.cycle.ports, []
        book = group.controller._step

        def noted(holds: int, *known: Any) -> Any:
            missed.append(holds)
            return book(holds, *known)

        group.controller._step = noted
        run(built.cycle, cycles=1000)
        skipped = built.rig.skipped_syncs
    assert skipped >= 4
    assert (max(missed), sum(missed)) == (skipped, skipped)
