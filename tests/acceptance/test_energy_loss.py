"""A run that goes on giving out energy ends: exit status 3, zero torque first, and the account says how much it was."""

import json
import random
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from canhaptic.cli.main import main
from canhaptic.control.ledger import EnergyLossMeter
from canhaptic.cycle import run
from canhaptic.errors import EmergencyError, EnergyLostError, LinkError, SceneError, SyncsSkippedError
from canhaptic.replay import replay_bus_log
from canhaptic.scene.build import build, build_loss_meters
from canhaptic.scene.load import load_scene
from canhaptic.signals import Sample

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
DEMO = CONFIGS / "demo.yaml"
TOO_HEAVY = (
    "passivity={algorithm: guarded, moving_mass: 5 kg, hand_force: 0 N, hand_push: 0 N, device_damping_bound: 0}"
)
UNPROTECTED = "passivity={algorithm: unprotected}"
LIGHT = "simulation.plant={mass: 0.02 kg, damping: 0 N*s/m}"
ACTIVE = (LIGHT, "bus.rate=100 Hz", "environment.stiffness=3 kN/m")
HARD = ("environment.stiffness=3 kN/m", "simulation.user.stiffness=600 N/m")


def stalls(duration: float, every: float) -> str:
    return f"simulation.bus={{stall: [{{begin: 1.0, duration: {duration}, every: {every}}}]}}"


def ran(
    capsys: pytest.CaptureFixture[str],
    *values: str,
    scene: Path = DEMO,
    seconds: float = 6.0,
    options: Sequence[str] = (),
) -> dict[str, Any]:  # fmt: skip
    """Exit status, account and truth of a run."""
    words = [*options, *(word for value in values for word in ("--set", value))]
    status = main(["run", str(scene), "--duration", str(seconds), "--json", *words])
    answer: dict[str, Any] = json.loads(capsys.readouterr().out)
    return {
        "exit": status,
        **answer.get("result", answer),
        "message": f"{answer.get('error', '')}: {answer.get('faults', '')}",
    }


@pytest.mark.slow_but("10?mJ*")
@pytest.mark.parametrize(
    ("limit", "errors", "least"),
    [("10 mJ", ("EnergyLostError", "SyncsSkippedError"), -0.2), ("none", ("SyncsSkippedError",), -10.0)],
)
def test_a_host_that_is_late_for_more_syncs_than_it_sends_is_stopped(limit, errors: tuple[str, ...], least, capsys):
    """Without an end 16,376 SYNCs were skipped, and 67 J given out."""
    result = ran(capsys, stalls(0.045, 0.05), f"axes.0.energy_loss_limit={limit}", seconds=20.0)
    assert result["exit"] == 3
    assert result["message"].startswith(errors)
    assert result["link"]["skipped_syncs"] < 1300
    assert result["truth"]["handle"]["least_interaction"] > least


@pytest.mark.slow_but("values0", "values1")
@pytest.mark.parametrize(
    "values", [(TOO_HEAVY, *ACTIVE), (TOO_HEAVY, *ACTIVE, "bus.rpdo=event"), (stalls(0.024, 0.05), *HARD)]
)
def test_a_port_that_goes_on_giving_out_energy_is_stopped(values: tuple[str, ...], capsys) -> None:
    result = ran(capsys, *values)
    assert result["exit"] == 3
    assert "EnergyLostError: " in result["message"]
    assert "limit 0.01 J beyond the 0 J declared" in result["message"]
    assert result["ports"]["handle"]["least_interaction"] < -0.01
    assert -0.5 < result["truth"]["handle"]["least_interaction"] < -0.01  # as far as one hold goes beyond the limit


def test_what_was_declared_may_be_given_out(capsys: pytest.CaptureFixture[str]) -> None:
    allowed = TOO_HEAVY.replace("}", ", energy_allowance: 0.5 J}")
    result = ran(capsys, allowed, *ACTIVE, "axes.0.energy_loss_limit=1 mJ", options=["--large-allowance"])
    assert "limit 0.001 J beyond the 0.5 J declared" in result["message"]
    assert result["ports"]["handle"]["least_interaction"] < -0.5


def test_in_simulation_an_algorithm_that_promises_nothing_goes_on_unless_asked(capsys) -> None:
    result = ran(capsys, UNPROTECTED, *ACTIVE, seconds=2.0)
    assert (result["exit"], result["passive"]) == (0, "no")
    assert ran(capsys, TOO_HEAVY, *ACTIVE, "axes.0.energy_loss_limit=none", seconds=2.0)["exit"] == 0
    result = ran(capsys, UNPROTECTED, *ACTIVE, "axes.0.energy_loss_limit=50 mJ", seconds=2.0)
    assert (result["exit"], "EnergyLostError: " in result["message"]) == (3, True)


def test_a_real_interface_has_a_limit_whatever_the_algorithm() -> None:
    real = ["bus.interface=socketcan", "bus.channel=can0"]
    [meter] = build_loss_meters(load_scene(DEMO, [*real, UNPROTECTED]))
    assert (meter.limit, meter.allowance, meter.axes) == (0.01, 0.0, (0,))
    with pytest.raises(SceneError, match=r"axes\.0\.energy_loss_limit: got 'none', but the drives may be real"):
        load_scene(DEMO, [*real, "axes.0.energy_loss_limit=none"])


@pytest.mark.slow
def test_of_a_group_the_sum_of_its_axes_counts() -> None:
    """One handle of a coupled pair gives out what the other took in: that is no loss."""
    scene = load_scene(CONFIGS / "two_handles.yaml", ["axes.0.energy_loss_limit=2 mJ"])
    [meter] = build_loss_meters(scene)
    assert (meter.limit, meter.axes) == (0.002, (0, 1))
    with build(scene, "free") as experiment:
        run(experiment.cycle, 700)
        ledgers = experiment.cycle.ledgers[:2]  # of the axes; that of the group is behind them
        assert max(ledger.summary().least_interaction for ledger in ledgers) < -0.002


def sample(index: int, position: float, torque: float, *, fresh: bool = True) -> list[Sample]:
    return [Sample(index, position, torque, 0, fresh)]


def test_the_meter_counts_torque_times_displacement_over_all_holds_and_the_damping_of_the_device() -> None:
    meter = EnergyLossMeter("handle", (0,), limit=0.01, allowance=0.02, damping=(4.0,), sample_time=1e-3)
    assert not meter.take(sample(0, 5.0, 7.0), 0)  # the first only places it
    assert not meter.take(sample(1, 5.001, 10.0), 1)
    assert meter.energy == pytest.approx(-0.01 + 4.0 * 1e-6 / 1e-3)
    assert not meter.take(sample(2, 5.5, 10.0, fresh=False), 2)
    assert not meter.take(sample(3, 5.003, 5.0), 3)  # two holds: at least 4 N*s/m * (2 mm)^2 / 2 ms are dissipated
    assert meter.energy == pytest.approx(-0.01 + 0.004 - 0.01 + 0.008)
    assert meter.take(sample(4, 5.004, 40.0), 4)
    assert meter.energy == pytest.approx(-0.044)
    assert not meter.take(sample(5, 5.014, 0.0), 24)  # 19 SYNCs were skipped: 4 N*s/m * (10 mm)^2 / 20 ms
    assert meter.energy == pytest.approx(-0.044 + 0.02)


def test_the_replay_of_a_run_that_was_ended_is_ended_too(tmp_path: Path) -> None:
    scene = load_scene(DEMO, [TOO_HEAVY, *ACTIVE])
    path = tmp_path / "run.log"
    with build(scene, "free", bus_log=path) as experiment, pytest.raises(EnergyLostError):
        run(experiment.cycle, 4000)
    result = replay_bus_log(path, scene)
    assert (result["status"], "ENERGY_LOST" in result["ended"]) == ("identical", True)


@pytest.mark.slow_but("4")
@pytest.mark.parametrize("seed", range(12))
def test_no_run_loses_more_than_the_limit_and_one_hold_and_goes_on(seed: int) -> None:
    """Stalls, losses and masses drawn at random, on walls that are too stiff for them."""
    chance = random.Random(seed)
    stall = (
        f"stall: [{{begin: 0.5, duration: {chance.uniform(0.0, 0.03):.4f}, every: {chance.uniform(0.031, 0.1):.4f}}}]"
    )
    values = [
        f"passivity={{algorithm: guarded, moving_mass: {chance.choice([0.2, 1.0, 4.0])} kg, hand_force: 0 N, "
        "hand_push: 0 N, device_damping_bound: 0.2 N*s/m}",
        f"environment.stiffness={chance.choice([500, 3000, 15000])} N/m",
        "environment.side=below",
        f"simulation.bus={{{stall}, drop: {chance.choice([0.0, 0.1, 0.3])}}}",
        "axes.0.torque_limit=10 N",
        "axes.0.sdo_timeout=20 ms",
    ]
    with build(load_scene(DEMO, values), "free") as experiment:
        judge = experiment.cycle.judge
        assert judge is not None
        gone_on = 0

        def look(_cycles: int) -> None:
            nonlocal gone_on
            gone_on += judge.least[0] < -0.011 - 10.0 * 0.08  # a hold of a tenth of a second at 0.8 m/s

        with suppress(EnergyLostError, SyncsSkippedError, LinkError, EmergencyError):  # a drive may miss heartbeats
            run(experiment.cycle, 4000, progress=look)
        assert gone_on == 0
