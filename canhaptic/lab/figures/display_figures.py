"""The figures of an admittance display in a sweep, by name; a name of impedance displays means the same here."""

from collections.abc import Sequence
from math import nan
from typing import Final

import numpy as np

from canhaptic.lab.loop.display_loop import DisplayRun, felt, run_display
from canhaptic.scene.models import Scene

DISPLAY_METRICS: Final[dict[str, str]] = {
    "diverged": "1 where the run ended early: diverged, or what stops the rig, else 0",
    "cycles": "SYNCs that the figures are of",
    "interaction": "true energy through the sensors at the end [J]",
    "least_interaction": "least true energy through the sensors after any hold, eq. 3 [J]",
    "believed_error": "largest |accounted - true| energy after any hold [J]",
    "energy_resolution": "uncertainty of the energy that came in [J]",
    "surplus_end": "h_dis at the end [J]",
    "mass_felt": "mass that fits true force and velocity best [kg or kg*m^2]",
    "mass_felt.share": "that over the mass asked",
    "damping_felt": "damping that fits true force and velocity best [N*s/m or N*m*s/rad]",
    "guard_acts": "share of the holds with a command that a certificate cut",
    "uncertified": "share of the holds without a certificate",
    "speed_peak": "largest true |velocity| at a SYNC [m/s or rad/s]",
    "force_peak": "largest true |force| at a SYNC [N or N*m]",
    "travel": "largest less least true position, of the axis that moves most [m or rad]",
    "certificate": "weakest of any hold, by its number in the log: 0 exact, 4 none, 5 velocity loop, 6 hand force",
}
"""Name -> meaning."""


def display_figures(scene: Scene, cycles: int, metrics: Sequence[str] | None = None) -> dict[str, float]:
    """Return the figures of one display, or of one group of them; NaN for those that only impedance displays have.

    Args:
        scene: Scene of that part alone, simulated.
        cycles: SYNCs.
        metrics: Names; None for all of `DISPLAY_METRICS`.

    Raises:
        InputError: An axis is not simulated.
        ParameterError: The controller cannot be built.
    """
    run = run_display(scene, cycles)
    found = figures_of(run, scene)
    return {name: found.get(name, nan) for name in (DISPLAY_METRICS if metrics is None else metrics)}


def figures_of(run: DisplayRun, scene: Scene) -> dict[str, float]:
    """Return every figure of a run of a scene."""
    mass, damping = felt(run, scene)
    motion, asked = run.columns(), _mass_asked(scene)
    moved = len(motion) > 0
    return {
        "diverged": float(bool(run.ended) or run.diverged),
        "cycles": float(run.cycles),
        "interaction": run.interaction,
        "least_interaction": run.least_interaction,
        "believed_error": run.believed_error,
        "energy_resolution": run.resolution,
        "surplus_end": run.surplus,
        "mass_felt": mass,
        "mass_felt.share": mass / asked if asked else nan,
        "damping_felt": damping,
        "guard_acts": run.cut / run.moving if run.moving else 0.0,
        "uncertified": run.uncertified / max(1, run.cycles),
        "speed_peak": float(np.abs(motion[:, :, 1]).max()) if moved else nan,
        "force_peak": float(np.abs(motion[:, :, 2]).max()) if moved else nan,
        "travel": float(np.ptp(motion[:, :, 0], axis=0).max()) if moved else nan,
        "certificate": float(run.certificate),
    }


def _mass_asked(scene: Scene) -> float | None:
    """Mass that a scene of one part is to render [kg or kg*m^2]; None where it has none."""
    part = scene.groups[0].network if scene.groups else scene.axes[0].environment
    asked = getattr(part.parameters, "inertia", getattr(part.parameters, "mass", None))
    return None if asked is None else float(asked)
