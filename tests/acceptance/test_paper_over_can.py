"""The paper's figures through the whole CAN path in lock-step, judged by the frames on the bus (A9, A10).

The reference is the continuous wall of the same user, by scipy's DOP853 with event location; the torque judged is the
one that the simulated drive reports in its TPDOs, decoded here from literal bytes.
"""

import struct
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from canhaptic.control.balance import Branch
from canhaptic.cycle import run
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from tests.control.reference_loop import continuous, user_f, variation

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
RATED = 10.0  # [N] of configs/paper_*.yaml


class OverCan(NamedTuple):
    torque: np.ndarray  # held during the hold that ended at SYNC k, from 0x6074 in the TPDO [N]
    position: np.ndarray  # [m]
    least_margin: float  # of sum(h_i) - sum(h_r) [J]
    least_interaction: float  # of the plant's own energy [J]
    believed_error: float  # [J]
    sticky: list[float]  # torques commanded in holds booked as sticky [N]


def over_can(config: str, *overrides: str, duration: float) -> OverCan:
    frames: list[tuple[int, bytes]] = []
    with build(load_scene(CONFIGS / config, overrides), "free") as experiment:
        link, cycle = experiment.rig.drives[0].link, experiment.cycle
        link._recorder = lambda _time, can_id, data, _is_rx: frames.append((can_id, bytes(data)))
        sticky: list[float] = []
        [controller] = [port.controller for port in cycle.ports]
        step = controller.step

        def watched(position: float, torque: float):
            balance = step(position, torque)
            if balance.branch == Branch.STICKY:
                sticky.append(balance.torque)
            return balance

        controller.step = watched
        cycles = round(duration / experiment.scene.bus.sample_time)
        run(cycle, cycles)
        [ledger], judge = cycle.ledgers, cycle.judge
        assert judge is not None
        summary = ledger.summary()
        result = (summary.margin_value, judge.least[0], judge.believed_error[0], sticky)
    words = [struct.unpack("<Hih", data) for can_id, data in frames if can_id == 0x181 and len(data) == 8]
    enabled = [(counts, per_mille) for status, counts, per_mille in words if status & 0x6F == 0x27][:cycles]
    position = np.array([counts for counts, _ in enabled]) * 1e-6
    torque = np.array([per_mille for _, per_mille in enabled]) * (RATED / 1000.0)
    return OverCan(torque, position, *result)


@pytest.fixture(scope="module")
def continuous_variation() -> Callable[[float, float, float, float], float]:
    known: dict[tuple[float, float, float, float], float] = {}

    def of(damping: float, wall: float, amplitude: float, duration: float) -> float:
        key = (damping, wall, amplitude, duration)
        if key not in known:
            times = np.arange(0.0, duration, 1e-4)
            known[key] = variation(continuous(user_f(amplitude), 100.0, damping, wall, times)[1])
        return known[key]

    return of


DURATION = 6.0


@pytest.mark.slow_but("synchronous-3.0-40")
@pytest.mark.parametrize("rate", [40, 100])
@pytest.mark.parametrize(("rpdo", "limit"), [("event", 1.5), ("synchronous", 3.0)])
def test_the_papers_algorithm_renders_figs_4_and_5_over_can_without_ringing(rate, rpdo, limit, continuous_variation):
    config = "paper_fig4_40hz.yaml" if rate == 40 else "paper_fig5_100hz.yaml"
    found = over_can(
        config, "passivity.algorithm=internal_dissipation", f"bus.rate={rate}", f"bus.rpdo={rpdo}", duration=DURATION
    )
    assert variation(found.torque) < limit * continuous_variation(5.0, 0.0, 0.1, DURATION)
    assert found.torque.max() > 3.0


@pytest.mark.slow
@pytest.mark.parametrize("rpdo", ["event", "synchronous"])
def test_the_original_shows_fig_4_and_fails_in_fig_5_over_can(rpdo: str, continuous_variation) -> None:
    reference = continuous_variation(5.0, 0.0, 0.1, DURATION)
    ratios = {
        config: variation(over_can(config, f"bus.rpdo={rpdo}", duration=DURATION).torque) / reference
        for config in ("paper_fig4_40hz.yaml", "paper_fig5_100hz.yaml")
    }
    if rpdo == "event":
        assert ratios["paper_fig4_40hz.yaml"] < 1.5
    assert ratios["paper_fig5_100hz.yaml"] > 10.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("config", "rpdo", "limit"),
    [
        ("paper_fig7_40hz.yaml", "event", 1.5),
        ("paper_fig8_100hz.yaml", "event", 1.5),
        ("paper_fig8_100hz.yaml", "synchronous", 3.0),
    ],
)
def test_figs_7_to_9_over_can_keep_eq_4_and_stick_before_the_exit(config, rpdo, limit, continuous_variation) -> None:
    found = over_can(config, f"bus.rpdo={rpdo}", duration=DURATION)
    assert found.least_margin >= -5e-3
    assert found.least_interaction >= -5e-3
    assert min(found.sticky) < 0.0  # the damper holds back while the user pulls out: the sticky effect of Figs. 7-8
    assert variation(found.torque) < limit * continuous_variation(10.0, -0.05, 0.15, DURATION)
    assert_believed_within_the_encoders_bound(found)


@pytest.mark.slow
def test_fig_7_one_sample_late_is_calm_only_with_capped_damping_and_then_still_loses_energy_at_the_exit(
    continuous_variation,
) -> None:
    """10 N*s/m at 40 Hz, one sample late, is d T / m = 1.0, beyond the 0.828 at which any sampled damper diverges.

    Where the mass is given, the damping is capped and the force is calm. But the user leaves at 0.4 m/s, 12 mm a hold,
    with two computed torques still to come: the paper's algorithm has no bound on those, and eq. 4 fails by some 60 mJ.
    """
    found = over_can("paper_fig7_40hz.yaml", "bus.rpdo=synchronous", "passivity.moving_mass=0.25", duration=DURATION)
    assert variation(found.torque) < 3.0 * continuous_variation(10.0, -0.05, 0.15, DURATION)
    assert -0.1 < found.least_margin < -5e-3
    assert_believed_within_the_encoders_bound(found)
    uncapped = over_can("paper_fig7_40hz.yaml", "bus.rpdo=synchronous", duration=DURATION)
    assert uncapped.least_margin < -1.0


def assert_believed_within_the_encoders_bound(found: OverCan) -> None:
    """Half a count times the variation of the torque: the tight bound of what an encoder can hide (trap 12)."""
    assert found.believed_error <= 0.5e-6 * (variation(found.torque) + abs(found.torque[-1])) + 1e-12
