"""Does asking for a stiffer wall ever give a softer one? Stiffness felt after 20 s of leaning, over a grid of rigs.

    python -m tools.felt_grid

Asked stiffnesses x counts x rates x three hands and masses, in the compiled loop on a plant with dry friction. A row is
good if each stiffness felt is at least 0.95 of the best that a smaller request gives.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from canhaptic.lab.batch.scalar import render
from canhaptic.lab.loop.axis_loop import loop_case
from canhaptic.scene.load import load_scene

_SCENE: Final = Path(__file__).resolve().parents[1] / "configs" / "published" / "phantom_premium_15.yaml"
ASKED: Final = (1e3, 2e3, 3e3, 5e3, 8e3, 1e4, 1.5e4, 2e4, 3e4, 6e4, 1e5)
"""Stiffnesses asked [N/m]."""
COUNTS: Final = (30e-6, 10e-6, 3e-6, 1e-6)
"""Counts of the encoder [m]."""
RATES: Final = (1000.0, 250.0)
"""Rates of SYNC [Hz]."""
LEAST: Final = 0.95
"""Share of the best that a smaller request gives, above which a row is good."""
_SECONDS, _LAST = 20.0, 2.0


class Hand(NamedTuple):
    """A rig and the hand that leans on its wall."""

    mass: float  # declared; the true one is 7 % larger [kg]
    friction: float  # [N]
    limit: float  # of the torque [N]
    pull: float  # declared [N]
    push: float  # declared [N]
    stiffness: float  # [N/m]
    damping: float  # [N*s/m]
    depth: float  # of what it wants to reach in the wall [m]
    swing: float  # by which it goes to and fro [m]
    frequency: float  # [Hz]


HANDS: Final = {
    "tip": Hand(0.07, 0.04, 8.5, 0.0, 2.0, 200.0, 3.0, 7e-3, 0.7e-3, 1.0),
    "arm": Hand(0.25, 0.15, 20.0, 0.0, 8.0, 500.0, 6.0, 10e-3, 1e-3, 0.7),
    "firm": Hand(0.15, 0.08, 12.0, 1.0, 8.0, 800.0, 4.0, 5e-3, 1.5e-3, 2.0),
}


def sets_of(hand: Hand, asked: float, count: float, rate: float) -> list[str]:
    """Returns the changes of the scene for a cell of the grid."""
    return [
        f"environment.stiffness={asked}", f"bus.rate={rate}", f"axes.0.counts_per_unit={1.0 / count}",
        f"axes.0.torque_limit={hand.limit}", f"simulation.plant.mass={1.07 * hand.mass}",
        f"passivity={{algorithm: guarded, moving_mass: {hand.mass}, hand_push: {hand.push}, hand_force: {hand.pull}, "
        f"torque_window: 0, device_friction: {hand.friction}, device_friction_bound: {hand.friction}, "
        "device_damping_bound: 0.05}",
        f"simulation.user={{stiffness: {hand.stiffness}, damping: {hand.damping}, motion: {{type: sinusoid, "
        f"amplitude: {hand.swing}, frequency: {hand.frequency}, offset: {-hand.depth}}}}}",
        f"simulation.effects=[{{type: coulomb_friction, static: {hand.friction}, kinetic: {hand.friction}}}]",
    ]  # fmt: skip


def felt(hand: Hand, asked: float, count: float, rate: float) -> float:
    """Returns the stiffness felt in the last seconds [N/m]: of the spring that gives most of the torque."""
    scene = load_scene(_SCENE, sets_of(hand, asked, count, rate))
    run = render(loop_case(scene.axes[0], scene), round(_SECONDS * rate), engine="numba")
    last, places = round(_LAST * rate), run.true_position
    depth = np.maximum(0.0, -0.5 * (places[1:] + places[:-1]))[-last:]
    square = float(depth @ depth)
    return float(run.torque[-last:] @ depth) / square if square else 0.0


def worst_of(found: Sequence[float]) -> float:
    """Returns the least stiffness felt, as a share of the best that a smaller request gives."""
    return min(one / max(found[: place + 1]) for place, one in enumerate(found))


def main() -> None:
    """Prints a row for each hand, rate and count."""
    for name, hand in HANDS.items():
        for rate in RATES:
            for count in COUNTS:
                found = [felt(hand, asked, count, rate) for asked in ASKED]
                shown = " ".join(f"{one:.0f}" for one in found)
                print(f"{name} {rate:g} Hz {1e6 * count:g} um: {shown}; worst {worst_of(found):.2f}", flush=True)


if __name__ == "__main__":
    main()
