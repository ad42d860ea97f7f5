"""One run beside the continuous one, in figures. Energies [J] are those of the plant unless they say believed."""

from typing import Any, Final

import numpy as np

from canhaptic.control.environments.environment import Environment
from canhaptic.study.loop import Array, LoopRun
from canhaptic.study.reference.continuous_reference import Reference

LAST_PART: Final = 0.1
"""Part of a run, at its end, in which rest and limit cycles are looked at; at most `LONGEST_LAST` [s]."""
LONGEST_LAST: Final = 2.0
_LEAST_EFFORT: Final = 1e-9  # [N or N*m] below which there is nothing to be rendered


def figures(environment: Environment, run: LoopRun, reference: Reference | None, sample_time: float) -> dict[str, Any]:
    """Returns the figures of one run as plain values; None where there is nothing to measure.

    Args:
        environment: What was rendered.
        run: Of one algorithm.
        reference: The continuous run of the same user; None where there is none.
        sample_time: [s].
    """
    margin = run.interaction - run.dissipated
    worst = int(margin.argmin())
    damping = run.damping[np.isfinite(run.damping)]
    return {
        "diverged": len(run.position) * sample_time if run.ended == "diverged" else None,
        **_errors(run, reference),
        "force_variation": _variation(run, reference),
        **_at_rest(environment, run, reference, sample_time),
        "damping_rendered": {
            "asked": environment.damping,
            "mean": float(damping.mean()) if damping.size else None,
            "least": float(damping.min()) if damping.size else None,
            "most": float(damping.max()) if damping.size else None,
        },
        "least_interaction": run.least_interaction,
        "interaction": float(run.interaction[-1]),
        "margin": {"value": min(0.0, float(margin[worst])), "time": worst * sample_time},
        "believed_margin": run.summary.margin_value,
        "believed_error": run.believed_error,
        "residual": run.residual,
        "certificate": run.summary.certificate.name.lower(),
        "surplus_end": run.summary.surplus_end,
        "branches": dict(run.summary.branches),
    }


def _errors(run: LoopRun, reference: Reference | None) -> dict[str, Any]:
    if reference is None:
        return {"position_error": None, "force_error": None}
    shown = min(len(run.position), len(reference.position))
    return {
        "position_error": _size(run.true_position[:shown] - reference.position[:shown]),
        "force_error": _size(run.torque[:shown] - reference.torque[:shown]),
    }


def _size(error: Array) -> dict[str, float]:
    return {"rms": float(np.sqrt(np.mean(error * error))), "max": float(np.abs(error).max(initial=0.0))}


def _variation(run: LoopRun, reference: Reference | None) -> dict[str, float | None]:
    """Total variation of the torque, and over that of the continuous force: 1 is as calm as the real thing."""
    known = reference is not None and reference.variation > _LEAST_EFFORT and not run.ended
    return {"value": run.variation, "ratio": run.variation / reference.variation if known and reference else None}


def last_rows(cycles: int, sample_time: float) -> slice:
    """Returns the rows of the last part of a run."""
    length = min(LAST_PART * cycles, LONGEST_LAST / sample_time)
    return slice(cycles - max(2, round(length)), cycles)


def _at_rest(environment: Environment, run: LoopRun, reference: Reference | None, sample_time: float) -> dict[str, Any]:
    """Stiffness and limit cycle over the last part, where the continuous axis rests there."""
    nothing: dict[str, Any] = {"stiffness_rendered": None, "limit_cycle": None}
    rows = last_rows(len(run.position), sample_time)
    if reference is None or run.ended or not reference.rests(rows):
        return nothing
    moving = np.ptp(reference.position[rows])
    cycle = max(0.0, float(np.ptp(run.true_position[rows]) - moving))
    return {"stiffness_rendered": _stiffness(environment, run, rows), "limit_cycle": cycle}


def _stiffness(environment: Environment, run: LoopRun, rows: slice) -> dict[str, float] | None:
    """Returns mean force over mean penetration, and mean force over the effort asked for where the axis was."""
    if environment.relaxes:
        return None
    positions, torque = run.true_position[rows].tolist(), -float(run.torque[rows].mean())
    states = [environment.true_state(q, 0.0, 0.0) if environment.contact(q) else 0.0 for q in positions]
    state = float(np.mean(states))
    asked = float(np.mean([environment.effort(x) for x in states]))
    if abs(asked) < _LEAST_EFFORT or state == 0.0:
        return None
    return {"value": torque / state, "share": torque / asked}
