"""What a group renders with frames that may be lost: nearly what it renders without."""

from pathlib import Path

import pytest

from canhaptic.lab.batch.network_loop import network_loop, shares
from canhaptic.lab.batch.scalar import run_network
from canhaptic.scene.load import load_scene

CONFIGS = Path(__file__).resolve().parents[3] / "configs"


def rendered(scene, losses, hand_force):
    """Returns share of stiffness and damping rendered in 2 s of a scene, and the least true energy [J]."""
    own = [f"groups.0.passivity.max_consecutive_losses={losses}", f"groups.0.passivity.hand_force={hand_force} N"]
    loaded = load_scene(CONFIGS / f"{scene}.yaml", [*own, "simulation.bus={jitter: 1 us}"])
    meter = run_network(network_loop(loaded, explains=True), 2000, "python")
    return *shares(meter), meter.figures.least_interaction


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "losses", "hand_force"),
    [("two_handles", 2, 0), ("two_handles", 1, 5), ("xy_box", 2, 5), ("xy_box", 0, 20)],
)
def test_a_group_whose_frames_may_be_lost_renders_nearly_all(scene, losses, hand_force):
    """0.04, 0, 0.93 and 0.51 of the stiffness while every torque of the last holds was paid for by itself."""
    stiffness, damping, least = rendered(scene, losses, hand_force)
    assert stiffness > 0.9
    assert damping > 0.75
    assert least >= -1e-9
