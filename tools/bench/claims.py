"""What each rival says of itself, on its own ground: the rule that its source states, checked on the rig of the arena.

A claim that has a number of a device is in `published`. Of rivals of which code alone was read there is no claim.
"""

from dataclasses import replace
from typing import Final

import numpy as np

from canhaptic.control.verdict import PASSIVE_TOLERANCE
from canhaptic.files import shipped
from canhaptic.lab.batch.scalar import render
from canhaptic.lab.figures.figures import energy_beyond_device
from canhaptic.lab.loop.axis_loop import LoopRun, cycles_of, loop_case
from canhaptic.lab.studies.arena import scene_under, with_loop
from canhaptic.lab.studies.map import theory_of
from canhaptic.scene.method import simulation_of
from canhaptic.scene.models import Scene
from tools.bench.report import Row, publish
from tools.paper_runs import figures_of, record

_PACKAGES: Final = ("canhaptic", "numpy")
_RIG: Final = shipped("configs") / "arena_rig.yaml"
_WALLS: Final = np.geomspace(1e2, 1e6, 9)  # [N/m]
_ACTIVE: Final = 5000.0
"""A plain wall of so much gives energy out on the rig [N/m]."""
_LESS: Final = 0.5


def on_rig(algorithm: str, stiffness: float, damping: float = 0.0) -> tuple[Scene, LoopRun]:
    """Returns the rig with a wall [N/m, N*s/m] under an algorithm, and its run without delay."""
    scene = scene_under(_RIG, algorithm)
    scene = with_loop(scene, scene.bus.rate, 0)
    [axis] = scene.axes
    wall = axis.environment.parameters.model_copy(update={"stiffness": stiffness, "damping": damping})
    scene = replace(scene, axes=(replace(axis, environment=axis.environment._replace(parameters=wall)),))
    return scene, render(loop_case(scene.axes[0], scene), cycles_of(scene, None))


def beyond(algorithm: str) -> float:
    """Returns the most energy of any wall that came out beyond what the device takes [J]."""
    most = 0.0
    for stiffness in _WALLS.tolist():
        scene, run = on_rig(algorithm, stiffness)
        device = scene.axes[0].loop.device_damping or 0.0
        most = max(most, energy_beyond_device(run, device, scene.bus.sample_time))
    return most


def of_the_field() -> list[Row]:
    """Returns the claims about passivity of the display and of what is observed."""
    bound = theory_of(on_rig("unprotected", 100.0)[0]).colgate or 0.0
    scene, below = on_rig("unprotected", 0.99 * bound)
    plant = simulation_of(scene.axes[0]).plant
    out = energy_beyond_device(below, plant.damping, scene.bus.sample_time)
    plain, observed, tank, ultimate = (
        on_rig(name, _ACTIVE)[1] for name in ("unprotected", "passivity_observer", "energy_tank", "ultimate_passivity")
    )
    left = float(observed.believed[-1])
    rows = [
        _row("unprotected: passive below 2 b / T, energy beyond the device at 99 % of it", out, "J"),
        _row("passivity_observer: wins back what it observes, energy short at the end", max(0.0, -left), "J"),
    ]
    parts = {"passivity_observer": observed, "energy_tank": tank, "ultimate_passivity": ultimate}
    for name, run in parts.items():
        part = run.least_interaction / plain.least_interaction
        rows.append(Row(f"{name}: gives out less, over what the plain wall gives out", part, "1", met=part < _LESS))
    for name in ("energy_bounding", "guarded"):
        rows.append(_row(f"{name}: no energy beyond what it promises, at any stiffness", beyond(name), "J"))
    return rows


def of_the_paper() -> list[Row]:
    """Returns the claims of the paper, through the whole CAN path."""
    fig4, fig5, fig7, fig8 = (
        figures_of(record(f"paper_{name}.yaml")) for name in ("fig4_40hz", "fig5_100hz", "fig7_40hz", "fig8_100hz")
    )
    varies = "force_variation_over_continuous"
    ratio, calm = fig5[varies] / fig4[varies], max(fig7[varies], fig8[varies])
    return [
        Row("a_priori_dissipation: fails at the higher rate, force variation at 100 over 40 Hz", ratio, "1",
            target="> 10", met=ratio > 10.0),
        Row("internal_dissipation: calm at both rates, largest force variation", calm, "1",
            target="< 1.3", met=calm < 1.3),
        _row("internal_dissipation: keeps (4), missing in Fig. 8", max(0.0, -fig8["least_margin"]), "J"),
    ]  # fmt: skip


def _row(claim: str, missing: float, unit: str) -> Row:
    return Row(claim, missing, unit, target="<= 1 uJ", met=missing <= PASSIVE_TOLERANCE)


def main() -> None:
    """Checks every claim and publishes."""
    publish("claims", [*of_the_field(), *of_the_paper()], _PACKAGES)


if __name__ == "__main__":
    main()
