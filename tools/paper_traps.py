"""What each trap in the printed equations costs: the printed rule against the one that is built, on the same scene.

The printed rules live here only. Energies are those of the simulated plant unless they say otherwise; SI units.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager
from decimal import Decimal, localcontext
from functools import partial
from math import copysign, isfinite, sqrt
from typing import Any, Final
from unittest.mock import patch

import numpy as np

from canhaptic.control.balance import Branch
from canhaptic.control.damping import largest_stable_damping, least_oscillating_damping
from canhaptic.control.environments import Environment
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.passivity import LoopProperties, build_controller
from canhaptic.control.passivity.internal_dissipation import (
    InternalDissipation,
    Storage,
    StoredModelSettings,
    solve,
    solve_balance,
)
from canhaptic.control.passivity.stepped import Axis, AxisMemory, Hold, HoldSettings, open_hold
from canhaptic.kernels.records import bound
from canhaptic.lab.batch.scalar import render
from tools.bench.standard_cases import (
    FIGURES_7_9,
    LEANING,
    TREMBLING,
    USER_S,
    standard_case,
    standard_reference,
    user_f,
)
from tools.paper_runs import Record, record

_PAPER: Final = "internal_dissipation"
_PAPERS: Final = ("passivity={algorithm: internal_dissipation}",)


class _PositiveState(SpringDamperWall):
    """Eq. 18 as printed: the state of an energy is positive, where contact has x < 0."""

    def state_of_energy(self, energy: float, like: float) -> float:
        return abs(super().state_of_energy(energy, like))


def _stepped_with(**instead: Callable[..., object]) -> AbstractContextManager[object]:
    """While it lasts, the paper's algorithm is stepped with other functions, by name."""
    kernel = InternalDissipation.kernel
    step = bound(kernel.step, {name: partial(function) for name, function in instead.items()})
    return patch.object(InternalDissipation, "kernel", kernel._replace(step=step))


def _with_newest_effort(
    settings: HoldSettings, axis: Axis, memory: AxisMemory, position: float, torque_applied: float
) -> Hold:
    """Eq. 15 with the damper effort of the newest command, at every delay between command and hold."""
    newest = memory.commands.dampers[axis.oldest - 1]
    return open_hold(settings, axis, memory, position, torque_applied)._replace(damper=newest)


def sign_of_18() -> dict[str, float]:
    """Trap 1: rms error of the position to the continuous wall's [m], Fig. 8."""
    reference = standard_reference(FIGURES_7_9, user_f(0.15), 100.0, 400)

    def rms(wall: SpringDamperWall) -> float:
        run = render(standard_case(wall, _PAPER, 100.0, user_f(0.15)), 400)
        return float(np.sqrt(np.mean((run.true_position - reference.position) ** 2)))

    return {"as_built": rms(FIGURES_7_9), "as_printed": rms(_PositiveState(**FIGURES_7_9.model_dump()))}


def digits_of_16() -> dict[str, float]:
    """Trap 2: relative error of the root for a motion of 1 pm, 10 mm inside 100 N/m, without damper velocity."""
    k, state, moved = 100.0, -0.010, -1e-12
    effort, energy = k * state, -k * -state * moved
    printed = (-effort - copysign(sqrt(effort * effort + 2.0 * k * energy), -effort)) / k
    built = solve_balance(k, effort, energy, moved)
    with localcontext() as context:
        context.prec = 60
        b, h = Decimal(effort), Decimal(energy)
        exact = 2 * h / (b - (b * b + 2 * Decimal(k) * h).sqrt())
        errors = [abs(float((Decimal(root) - exact) / exact)) for root in (built, printed)]
    return {"as_built": errors[0], "as_printed": errors[1]}


def negative_dissipation() -> dict[str, float]:
    """Trap 3: sum of the negative H_R that eq. 15 would book where the motion reverses [J], 3 s of 8 Hz tremor."""
    wall, given = SpringDamperWall(stiffness=1000.0, damping=50.0), [0.0]

    def signed(
        environment: Environment, settings: StoredModelSettings, storage: Storage, moved: float, damper: float,
        h_m: float,
    ) -> float:  # fmt: skip
        change = solve(environment, settings, storage, moved, damper, h_m)
        given[0] += min(0.0, damper * change) if isfinite(change) else 0.0
        return change

    with _stepped_with(solve=signed):
        render(standard_case(wall, _PAPER, 1000.0, LEANING, effects=TREMBLING), 3000)
    return {"as_printed": -given[0]}


def deep_start() -> dict[str, float]:
    """Trap 4: first force [N] when switched on at rest 20 mm inside 100 N/m and 10 N*s/m, at 10 kHz."""
    wall, sample_time = SpringDamperWall(stiffness=100.0, damping=10.0), 1e-4
    made = build_controller(wall, _PAPER, None, LoopProperties(sample_time=sample_time))
    forces = [made.step(-0.020, 0.0).torque for _ in range(3)]
    return {
        "as_built": max(map(abs, forces)),
        "as_printed": wall.stiffness * 0.020 + wall.damping * 0.020 / sample_time,
        "after_a_push_of_a_micrometre": made.step(-0.020001, 0.0).torque,
    }


def starts() -> dict[str, float]:
    """Trap 5: energy created by first-order starts [J], 6 s of tapping three times a second."""
    printed, guarded = record("hard/tapping.yaml", _PAPERS), record("hard/tapping.yaml")
    return {
        "holds_of_starts": printed.summary.branches["start"],
        "as_printed": printed.summary.generated,
        "guarded": guarded.summary.generated,
        "margin_as_printed": printed.summary.margin_value,
        "margin_guarded": guarded.summary.margin_value,
    }


def damping_limits() -> dict[str, dict[str, float]]:
    """Trap 9: d T / m at which a sampled damper ripples and diverges, by delay [samples]."""
    return {
        f"delay_{delay}": {
            "ripples": least_oscillating_damping(delay, 1.0, 1.0),
            "diverges": largest_stable_damping(delay, 1.0, 1.0),
        }
        for delay in (0, 1, 2)
    }


def saturation() -> dict[str, dict[str, float]]:
    """Trap 10: error [J] of an account that books commands, and of the one that books what was read back."""
    found = {}
    for limit in (5, 2):
        run = record("hard/torque_saturation.yaml", (*_PAPERS, f"axes.0.torque_limit={limit} N"))
        commanded = -np.cumsum(run.command[:-1] * np.diff(run.position))
        found[f"limit_{limit}_n"] = {
            "largest_command": float(np.abs(run.command).max()),
            "commands_booked": float(np.abs(commanded - run.true[1:]).max()),
            "as_built": _believed_error(run),
        }
    return found


def pairing() -> dict[str, float]:
    """Trap 11: force variation over the continuous wall's, Figs. 7-9 at 1 kHz with one sample of delay."""

    def variation() -> float:
        run = render(standard_case(FIGURES_7_9, _PAPER, 1000.0, user_f(0.15), delay=1), 4000)
        return run.variation / standard_reference(FIGURES_7_9, user_f(0.15), 1000.0, 4000).variation

    built = variation()
    with _stepped_with(open_hold=_with_newest_effort):
        return {"as_built": built, "as_printed": variation()}


def encoder() -> dict[str, dict[str, float]]:
    """Trap 12: force variation over the continuous wall's by velocity of the damper, 0.1 mm counts at 10 kHz."""
    wall, cycles = SpringDamperWall(stiffness=1000.0, damping=50.0), 10_000
    reference = standard_reference(wall, USER_S, 1e4, cycles)
    found = {}
    for velocity in ("last", "windowed"):
        run = render(standard_case(wall, _PAPER, 1e4, USER_S, encoder_count=1e-4, velocity=velocity), cycles)
        error = run.true_position - reference.position
        found[velocity] = {
            "force_variation": run.variation / reference.variation,
            "position_rms_error": float(np.sqrt(np.mean(error * error))),
        }
    return found


def lost_frames() -> dict[str, float]:
    """Trap 13: largest difference of believed and true energy either way [J], 4 s with 1 % of all frames lost.

    Looked at where a hold was booked: one whose position was lost is booked with the next.
    """
    lossy = ("duration=4 s", "simulation.bus={drop: 0.01}")
    run = record("demo.yaml", (*_PAPERS, *lossy))
    ahead = (np.cumsum(run.h_i) - run.true)[run.branch != Branch.HELD.value]
    return {
        "held": run.summary.branches["held"],
        "believed_too_much": float(ahead.max()),
        "believed_too_little": float(-ahead.min()),
        "encoders_bound": 0.5e-6 * float(np.abs(np.diff(run.torque, prepend=0.0)).sum() + abs(run.torque[-1])),
        "exchanged": run.summary.energy_in,
    }


def read_back() -> dict[str, float]:
    """Trap 14: error of the account [J] by what is read back, 4 s of the demo without and with a current loop."""
    lag = ("simulation.effects=[{type: current_loop, time_constant: 300 us}]",)
    found = {}
    for name, words in (
        ("demand_ideal_drive", ()),
        ("demand_current_loop", lag),
        ("actual_current_loop", (*lag, "axes.0.read_back=actual", "axes.0.torque_tolerance=1")),
    ):
        found[name] = _believed_error(record("demo.yaml", ("duration=4 s", *_PAPERS, *words)))
    return found


def _believed_error(run: Record) -> float:
    return float(np.abs(np.cumsum(run.h_i) - run.true).max())


def traps() -> dict[str, Any]:
    """Returns the figures of every trap that is a number of its own."""
    return {
        "1_sign_of_18": sign_of_18(),
        "2_digits_of_16": digits_of_16(),
        "3_negative_dissipation": negative_dissipation(),
        "4_deep_start": deep_start(),
        "5_starts": starts(),
        "9_damping_limits": damping_limits(),
        "10_saturation": saturation(),
        "11_pairing": pairing(),
        "12_encoder": encoder(),
        "13_lost_frames": lost_frames(),
        "14_read_back": read_back(),
    }
