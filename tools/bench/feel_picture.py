"""What `feel` measures, drawn: the force of a stiff wall over the position, and a slow hand that comes to rest."""

from typing import Any

import numpy as np

from canhaptic.control.certificates.scalar_bounds import displacement_response, start_energy
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.lab.batch.scalar import render
from canhaptic.lab.studies.design.contact_quality import SlowHand, enter
from tools.bench import feel
from tools.bench.report import picture_place
from tools.bench.standard_cases import USER_S, standard_case, standard_reference

PICTURE = "feel.png"
ENTRY = slice(490, 1020)  # of the run of user S: one contact [SYNCs]
LOOP = "100 Hz, one late, b 0.1"
HAND = SlowHand(0.02)
PUSH: dict[str, Any] = {"hand_push": feel.PRESS}


def draw() -> None:
    """Draws both panels."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 3.8), layout="constrained")
    wall, slow = figure.subplots(1, 2)
    _draw_wall(wall)
    _draw_slow_hand(slow)
    figure.savefig(picture_place(PICTURE), dpi=120, metadata={"Software": None})


def _draw_wall(plot: Any) -> None:
    reference = standard_reference(feel.STIFF_WALL, USER_S, 1000.0, 2000)
    plot.plot(1e3 * reference.position[ENTRY], reference.torque[ENTRY], "k", lw=2.0, label="continuous wall")
    runs: list[tuple[str, dict[str, Any]]] = [("unprotected", {}), ("guarded", {}), ("guarded", PUSH)]
    for name, options in runs:
        run = render(standard_case(feel.STIFF_WALL, name, 1000.0, USER_S, delay=1, **options), 2000)
        label = name + (f", pushes up to {feel.PRESS:g} N" if options else "")
        plot.step(1e3 * run.true_position[ENTRY], run.torque[ENTRY], lw=1.0, label=label)
    plot.set(xlabel="position [mm]", ylabel="force on the hand [N]", title="1e4 N/m, 20 N*s/m, 1 kHz, one sample late")
    plot.set_xlim(-1.2, 0.4)
    plot.legend(fontsize="small")


def _draw_slow_hand(plot: Any) -> None:
    rate, delay, damping = feel.LOOPS[LOOP]
    response = displacement_response(1.0 / rate, feel.MASS, 5.0, 0.0, damping)
    depth, stiffness = feel.certified_rest(response, delay, HAND)
    energy = start_energy(response, delay, stiffness)
    cases: dict[str, dict[str, Any]] = {
        "guarded, no energy": {},
        f"{1e3 * energy:.1f} mJ before the contact": {"energy_allowance": energy},
    }
    for label, options in cases.items():
        bench = feel.bench_of("guarded", LOOP, hand_force=5.0, **options)
        run = enter(bench, SpringDamperWall(stiffness=stiffness), HAND).run
        time = np.arange(len(run.true_position)) / rate
        plot.plot(time, -1e3 * run.true_position, lw=1.2, label=label)
    plot.axhline(1e3 * depth, color="k", ls="--", lw=1.0, label="rest at the certified stiffness")
    plot.axhline(0.0, color="k", lw=0.6)
    plot.set(xlabel="time [s]", ylabel="depth [mm]", title="0.02 m/s into a wall, 100 Hz, hand force 5 N")
    plot.legend(fontsize="small", loc="lower right")
