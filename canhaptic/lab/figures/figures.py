"""Definitions of all figures of a run: the sums that each needs; meaning and unit are those of `quantities.FIGURES`.

The sums are those of `meter`, gathered during a run or from recorded rows. Energies [J] are the plant's, unless the
name begins with `believed_`: those are the controller's account. There is one table for impedance displays, one for
admittance displays, and one for the figures of the arena (K-B plot, M-width, rate-hardness, impedance, drag, energy
given out), whose functions follow it; the time of a step is in `axis_loop`.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from math import inf, nan
from typing import Any, Final, NamedTuple, cast

import numpy as np

from canhaptic.control.balance import WEAKEST_LAST
from canhaptic.control.environments import Environment
from canhaptic.lab.figures.meter import Meter, MeterSettings, compare, diverge, take
from canhaptic.lab.loop.admittance_loop import felt, guarded_shares
from canhaptic.lab.loop.axis_loop import Array, LoopRun
from canhaptic.lab.reference import REST, ContinuousReference
from canhaptic.quantities import FIGURES, QuantityRow
from canhaptic.scene.models import Scene

_LAST_PART: Final = 0.1
"""Share of a run at its end in which rest and limit cycles are judged; at most `_LONGEST_LAST` [s]."""
_LONGEST_LAST: Final = 2.0
_LEAST_EFFORT: Final = 1e-9
"""Smallest requested effort whose rendered share is computed [N or N*m]."""
_LAST: Final = ("diverged", "continuous_travel", "continuous_rest")
_ERRORS: Final = ("position_squares", "position_worst", "force_squares", "force_worst")


class Figure(NamedTuple):
    """One figure of a run: what it is, and how it is computed."""

    row: QuantityRow  # unit, title, meaning
    sums: tuple[str, ...] = ()  # sums from which it is computed; fields of `meter.Meter`, and of the continuous run
    of: Callable[["_Moved"], float] = lambda _: nan  # computes the figure for an admittance display


_OF_BRANCHES: Final = ("free", "start", "exact", "sticky", "fallback", "depleted", "exit")
METRICS: Final = {
    name: Figure(FIGURES[name], sums)
    for name, sums in {
        **{
            name: (name,)
            for name in ("diverged", "cycles", "interaction", "least_interaction", "least_covered", "margin")
        },
        "accounted_margin": ("believed_margin",),
        "accounted_error": ("believed_error",),
        "surplus.end": ("surplus",),
        "torque_peak": ("torque_peak",),
        "force_ripple": ("variation",),
        "contact": ("contacts", "cycles"),
        "damping_rendered.mean": ("damping", "contacts"),
        "damping_rendered.least": ("damping_least", "contacts"),
        "damping_rendered.most": ("damping_most", "contacts"),
        "damping_rendered.share": ("damping", "damping_requested"),
        "effort_rendered.share": ("sizes_sent", "sizes_asked"),
        "stiffness_rendered.value": ("force", "state"),
        "stiffness_rendered.share": ("rendered", "asked"),
        "stiffness_at_end.share": ("last_force", "last_asked"),
        "travel": ("highest", "lowest"),
        "certificate": ("certificate",),
        **{f"branches.{name}": (name,) for name in _OF_BRANCHES},
    }.items()
}
"""Figures that need no continuous run. One that says which value is better is a row of `compare`."""

_AT_REST: Final = ("last_force", "last_state", "last_asked", "last", *_LAST)
CONTINUOUS: Final = {
    name: Figure(FIGURES[name], sums)
    for name, sums in {
        "position_error.rms": ("position_squares", "cycles"),
        "position_error.max": ("position_worst",),
        "force_error.rms": ("force_squares", "cycles"),
        "force_error.max": ("force_worst",),
        "force_ripple.ratio": ("variation", "diverged", "continuous"),
        "limit_cycle": ("last_highest", "last_lowest", *_LAST),
        "stiffness_at_rest.value": _AT_REST,
        "stiffness_at_rest.share": _AT_REST,
    }.items()
}
"""Figures that compare with a continuous run of the same user; NaN without one. A batch has a continuous run for walls
with spring and damper on one or two sides, dampers and free space, if the plant has no effects on its motion other than
viscous friction and tremor."""

_WEAKEST_LAST: Final[Array] = np.array(WEAKEST_LAST, dtype=float)

ALL: Final = {**METRICS, **CONTINUOUS}
"""All figures of an impedance display."""
OUTCOMES: Final = ("", "no contact", "nothing rendered")
"""Outcomes of a run: "" if the environment was touched and rendered; otherwise a passive run proves nothing."""
OUTCOME_METRICS: Final = ("contact", "effort_rendered.share", "damping_rendered.share", "torque_peak")
"""Metrics that decide the outcome."""
_LEAST_RENDERED: Final = 0.1  # as for the headline of a run


def outcomes(figure: Callable[[str], Any]) -> Any:
    """Return the outcome of runs as indices in `OUTCOMES`, of the shape of the figures.

    Nothing is rendered if less than a tenth of the requested effort was sent; where no effort was requested, if less
    than a tenth of the damping was rendered; where neither is known, if no torque was sent.

    Args:
        figure: Returns a metric of `OUTCOME_METRICS`; None or NaN where it is unknown.
    """
    contact, effort, damping, peak = (np.asarray(figure(name), dtype=float) for name in OUTCOME_METRICS)
    share = np.where(np.isfinite(effort), effort, damping)
    is_silent = np.where(np.isfinite(share), share < _LEAST_RENDERED, peak == 0.0)
    return np.where(contact == 0.0, 1, 2 * (is_silent & (contact > 0.0)))


def figures(
    environment: Environment, run: LoopRun, reference: ContinuousReference | None, sample_time: float,
    torque_limit: float | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Return the figures of one run by name, as plain values; None where a figure does not apply.

    Args:
        environment: Rendered environment.
        run: Run of one algorithm.
        reference: Continuous run of the same user, if it is known.
        sample_time: Sample time [s].
        torque_limit: Largest torque of the drive [N or N*m]; None: none.
    """
    margin = run.interaction - run.dissipated
    limit = inf if torque_limit is None else torque_limit
    by_place = getattr(environment, "damps_by_place", False)
    settings = MeterSettings(torque_limit=limit, damping=environment.damping, by_place=by_place)
    sums = _sums_of_run(environment, run, reference, sample_time, settings)
    return {name: _measured(name, sums) for name in ALL} | {
        "outcome": OUTCOMES[int(outcomes(lambda name: _measured(name, sums)))],
        "diverged": len(run.rows) * sample_time if run.ended == "diverged" else None,
        "damping_rendered.requested": environment.damping,
        "margin": run.least_margin,
        "margin.time": int(margin.argmin()) * sample_time,
        "residual": run.residual,
        "certificate": run.summary.certificate.name.lower(),
        **{f"branches.{name}": number for name, number in run.summary.branches.items()},
    }


def _measured(metric: str, sums: Mapping[str, float]) -> float | None:
    """Return a metric of one run; None where a sum is missing or the metric does not apply."""
    if not set(ALL[metric].sums) <= set(sums):
        return None
    value = float(metrics_of([metric], {name: np.array([sums[name]]) for name in ALL[metric].sums})[metric][0])
    return value if np.isfinite(value) else None


def _sums_of_run(
    environment: Environment, run: LoopRun, reference: ContinuousReference | None, sample_time: float,
    settings: MeterSettings,
) -> dict[str, float]:  # fmt: skip
    """Return the sums of one run by name; without a reference, those of the comparison with it are missing."""
    cycles = len(run.rows)
    meter, settings = Meter(), replace(settings, last_from=float(last_rows(cycles, sample_time).start))
    holds = (run.position, run.true_position, run.torque, run.interaction)
    for cycle, hold in enumerate(zip(*map(np.ndarray.tolist, holds), run.balances(), strict=True)):
        take(environment, settings, meter, cycle, *hold)
    if run.ended:
        diverge(meter)
    if reference is None:
        return {name: value for name, value in asdict(meter).items() if name not in _ERRORS}
    compared = (run.true_position, run.torque, reference.position, reference.torque)
    for values in zip(*map(np.ndarray.tolist, compared), strict=False):  # a run that diverged is shorter
        compare(meter, *values)
    return asdict(meter) | sums_of_continuous(reference, cycles, sample_time)


def sums_of_continuous(reference: ContinuousReference, cycles: int, sample_time: float) -> dict[str, float]:
    """Return the sums of a continuous run over some SYNCs, by name."""
    return {
        "continuous_travel": reference.travel,
        "continuous_rest": float(np.ptp(reference.position[last_rows(cycles, sample_time)])),
        "continuous": reference.variation,
    }


def last_rows(cycles: int, sample_time: float) -> slice:
    """Return the rows of the last part of a run."""
    length = min(_LAST_PART * cycles, _LONGEST_LAST / sample_time)
    return slice(max(0, cycles - max(2, round(length))), cycles)


def sums_of(metrics: Sequence[str]) -> tuple[str, ...]:
    """Return the sums that the given metrics need, each once."""
    return tuple(dict.fromkeys(name for metric in metrics for name in ALL[metric].sums))


def metrics_of(metrics: Sequence[str], sums: Mapping[str, Array]) -> dict[str, Array]:
    """Return metrics computed from the sums of many runs, shape (n_runs,) each; NaN where one does not apply."""
    with np.errstate(all="ignore"):
        return {metric: _metric(metric, sums) for metric in metrics}


def _metric(metric: str, sums: Mapping[str, Array]) -> Array:
    names = ALL[metric].sums
    first, second = sums[names[0]], sums[names[-1]]
    if metric in ("damping_rendered.least", "damping_rendered.most"):
        return np.where(second > 0.0, first, np.nan)
    if metric.startswith(("limit_cycle", "stiffness_at_rest")):
        return _at_rest(metric, sums)
    if metric == "force_ripple.ratio":
        return np.where((sums["diverged"] == 0.0) & (second > _LEAST_EFFORT), first / second, np.nan)
    if metric.endswith("_error.rms"):
        return np.sqrt(first / second)
    if len(names) == 1:
        return _WEAKEST_LAST[first.astype(int)] if metric == "certificate" else np.array(first)
    if metric == "stiffness_rendered.share":
        first = np.maximum(0.0, first)
    return first - second if metric == "travel" else np.where(second != 0.0, first / second, np.nan)


def _at_rest(metric: str, sums: Mapping[str, Array]) -> Array:
    """Return a metric of the last part of the runs; NaN where the continuous axis does not rest there."""
    rest = sums["continuous_rest"]
    rests = (sums["diverged"] == 0.0) & (rest <= REST * np.maximum(sums["continuous_travel"], 1e-9))
    if metric == "limit_cycle":
        return np.where(rests, np.maximum(0.0, sums["last_highest"] - sums["last_lowest"] - rest), np.nan)
    state, asked = sums["last_state"], sums["last_asked"]
    known = rests & (np.abs(asked) >= _LEAST_EFFORT * sums["last"]) & (state != 0.0)
    return np.where(known, sums["last_force"] / (state if metric.endswith("value") else asked), np.nan)


class _Moved(NamedTuple):
    """A run of an admittance display, with values that several figures need."""

    run: LoopRun
    motion: Array  # true positions, velocities and forces
    felt: tuple[float, float]  # apparent mass and damping, see `felt`
    asked: float  # requested mass [kg or kg*m^2]; 0: none
    shares: tuple[float, float, int]  # see `guarded_shares`


DISPLAY_METRICS: Final = {
    name: Figure(FIGURES[name], of=of)
    for name, of in cast(
        "dict[str, Callable[[_Moved], float]]",
        {
            "diverged": lambda d: bool(d.run.ended),
            "cycles": lambda d: len(d.run.rows),
            "interaction": lambda d: d.run.interaction[-1] if len(d.motion) else 0.0,
            "least_interaction": lambda d: d.run.least_interaction,
            "accounted_error": lambda d: d.run.believed_error,
            "energy_resolution": lambda d: d.run.resolution,
            "surplus.end": lambda d: d.run.booked.h_dis[-1] if len(d.motion) else 0.0,
            "mass_felt": lambda d: d.felt[0],
            "mass_felt.share": lambda d: d.felt[0] / d.asked if d.asked else nan,
            "damping_felt": lambda d: d.felt[1],
            "guard_acts": lambda d: d.shares[0],
            "uncertified": lambda d: d.shares[1],
            "speed_peak": lambda d: _most(np.abs(d.motion[:, :, 1])),
            "force_peak": lambda d: _most(np.abs(d.motion[:, :, 2])),
            "travel": lambda d: _most(np.ptp(d.motion[:, :, 0], axis=0) if len(d.motion) else d.motion),
            "certificate": lambda d: d.shares[2],
        },
    ).items()
}
"""Figures of an admittance display. A name that impedance displays use too has the same meaning."""


def _most(values: Array) -> float:
    return float(values.max()) if values.size else nan


def figures_of(run: LoopRun, scene: Scene) -> dict[str, float]:
    """Return all figures of a run of an admittance display or group."""
    known = scene.ports[0].rendered.parameters
    asked = getattr(known, "inertia", getattr(known, "mass", None)) or 0.0
    moved = _Moved(run, run.motion, felt(run, scene), float(asked), guarded_shares(run))
    return {name: float(figure.of(moved)) for name, figure in DISPLAY_METRICS.items()}


NEAR: Final = 0.05
"""Largest relative error of an accurately rendered stiffness."""

_WINDOW: Final = 0.02
"""Time after the first contact in which the rate of the force is measured [s]."""


def energy_given_out(run: LoopRun) -> float:
    """Return the largest net energy that the port generated, after any hold [J]; 0 for a passive run.

    Source: the condition of a passivity observer, Hannaford and Ryu 2002, doi:10.1109/70.988969, here with the energy
    of the plant instead of the booked energy.
    """
    return max(0.0, -run.least_interaction)


def energy_beyond_device(run: LoopRun, device_damping: float, sample_time: float) -> float:
    """Return the largest net energy generated beyond the device's own dissipation, after any hold [J].

    A display with a value of 0 is passive together with its device, even if its rendered environment alone is not:
    Colgate and Schenkel, "Passivity of a class of sampled-data systems", Journal of Robotic Systems 14, 1997 (condition
    quoted from secondary sources). In a hold with the displacement D a damping b dissipates at least b D^2 / T.

    Args:
        run: Run of an axis.
        device_damping: Guaranteed least damping of the device [N*s/m or N*m*s/rad].
        sample_time: Sample time [s].
    """
    moved = np.diff(run.true_position, prepend=run.true_position[:1])
    taken = np.cumsum(device_damping / sample_time * moved**2)
    return max(0.0, -float((run.interaction + taken).min(initial=0.0)))


def rate_hardness(run: LoopRun, environment: Environment, sample_time: float) -> float | None:
    """Return the largest rate of the force after the first contact, over the speed of that contact [N/m or N*m/rad].

    An ideal wall gives its stiffness. Source: Lawrence, Pao, Dougherty, Salada and Pavlou, "Rate-hardness: a new
    performance metric for haptic interfaces", IEEE Trans. Robotics and Automation 16, 2000 (abstract only).

    Args:
        run: Run that begins out of contact.
        environment: Rendered environment.
        sample_time: Sample time [s].

    Returns:
        None where there was no contact, the run began in contact, or the first contact had no speed.
    """
    touching = np.array([bool(environment.contact(q)) for q in run.true_position.tolist()])
    if not touching.any() or touching[0]:
        return None
    first = int(touching.argmax())
    speed = abs(run.true_position[first] - run.true_position[first - 1]) / sample_time
    last = first + max(2, math.ceil(_WINDOW / sample_time))
    rates = np.diff(np.abs(run.torque[first : last + 1])) / sample_time
    return float(rates.max(initial=0.0) / speed) if speed > 0.0 else None


def drag(run: LoopRun) -> float | None:
    """Return the mean magnitude of the torque held out of contact [N or N*m]; None without such a hold.

    It is the lower end of the Z-width, ideally 0: Colgate and Brown, "Factors affecting the Z-width of a haptic
    display", ICRA 1994, pp. 3205-3210 (quoted from secondary sources).
    """
    free = ~np.isfinite(run.damping[1:])  # no hold ends at the first SYNC
    return float(np.abs(run.torque[1:][free]).mean()) if free.any() else None


def rendered_impedance(run: LoopRun, sample_time: float, frequency: float) -> complex:
    """Return force over velocity at one frequency, over the whole periods of the last half [N*s/m or N*m*s/rad].

    A display is transparent if this equals the requested impedance at every frequency. Forces are constant over each
    hold; positions are sampled at the SYNCs.

    Args:
        run: Run with a hand that moves at this frequency, always in contact.
        sample_time: Sample time [s].
        frequency: Frequency [Hz]; below half of the rate.
    """
    omega, count = 2.0 * math.pi * frequency, len(run.position)
    periods = max(1, math.floor(0.5 * count * sample_time * frequency))
    rows = np.arange(count - round(periods / (frequency * sample_time)), count)
    turn = np.exp(-1j * omega * sample_time * rows)
    half = 0.5 * omega * sample_time
    position = np.sum(run.true_position[rows] * turn)
    force = np.sum(-run.torque[rows] * turn) * np.exp(1j * half) * math.sin(half) / half
    return complex(force / (1j * omega * position))


def asked_impedance(stiffness: float, damping: float, frequency: float) -> complex:
    """Return force over velocity of a spring with a damper [N*s/m or N*m*s/rad]."""
    return damping + stiffness / (2j * math.pi * frequency)


class StiffestWalls(NamedTuple):
    """Borders of a K-B plot; the arrays have the shape of the trials without their first dimension."""

    passive: Array  # largest stiffness up to which every wall is passive; 0: not even the least
    near: Array  # largest of these stiffnesses that is rendered within `NEAR`; 0: none
    is_open: Any  # whether every wall tried is passive, so that the border is beyond the range


def stiffest_walls(stiffnesses: Array, passive: Any, shares: Array) -> StiffestWalls:
    """Return the largest stiffness up to which all walls are passive, and the largest of these rendered accurately.

    Plotted over the wall's damping, this is the K-B plot or Z-width of Colgate and Brown 1994, as above.

    Args:
        stiffnesses: Stiffnesses tried, ascending, shape (n,) [N/m or N*m/rad].
        passive: Whether each wall was passive, shape (n, ...).
        shares: Rendered over requested stiffness, shape (n, ...); NaN where unknown.
    """
    kept = np.logical_and.accumulate(np.asarray(passive, dtype=bool), axis=0)
    near = kept & (np.abs(shares - 1.0) <= NEAR)
    column = stiffnesses.reshape(-1, *(1,) * (kept.ndim - 1))
    return StiffestWalls(
        np.where(kept, column, 0.0).max(axis=0), np.where(near, column, 0.0).max(axis=0), np.asarray(kept[-1])
    )


class MWidth(NamedTuple):
    """Range of stable virtual masses [kg or kg*m^2]."""

    least: float  # negative: the largest inertia that can be compensated
    most: float


def m_width(mass: float, damping: float, sample_time: float, delay: int = 0, cutoff: float = math.inf) -> MWidth:
    """Return the range of virtual masses that an unloaded device displays stably.

    Source: Colonnese and Okamura, "M-width: stability and accuracy of haptic rendering of virtual mass", RSS 2012, and
    IJRR 34, 2015, doi:10.1177/0278364914559294 (abstracts only: "the dynamic range of virtual masses renderable in a
    stable manner"). The virtual mass acts on the second backward difference of the sampled position, held over T.
    Without damping, delay and filter the loop is z^2 + (M / 2m) (z + 1) = 0, which is stable for -m < M < 2m.

    Args:
        mass: m, the mass of the device [kg or kg*m^2].
        damping: Damping of the device [N*s/m or N*m*s/rad].
        sample_time: T [s].
        delay: Delay in whole holds.
        cutoff: Cutoff of a first-order low-pass on the acceleration [Hz]; infinite: none.
    """
    decay = math.exp(-damping * sample_time / mass)
    moved = _moved_in_a_hold(mass, damping, sample_time)
    late = -math.expm1(-2.0 * math.pi * cutoff * sample_time) if math.isfinite(cutoff) else 1.0
    free = np.polymul([1.0, -decay], np.polymul([1.0, late - 1.0], [1.0] + [0.0] * (1 + delay)))
    held = np.polymul([1.0, -1.0], moved) * late / sample_time**2
    if damping == 0.0:  # a free mass keeps its speed: that root is no fault of the display
        free, held = np.polydiv(free, [1.0, -1.0])[0], np.polydiv(held, [1.0, -1.0])[0]

    def is_stable(virtual: float) -> bool:
        return bool(np.abs(np.roots(np.polyadd(free, virtual * held))).max() < 1.0)

    return MWidth(_last_stable(is_stable, -mass), _last_stable(is_stable, mass))


def _moved_in_a_hold(mass: float, damping: float, sample_time: float) -> Array:
    """Return [x1, x0] of the transfer function from held force to position, (x1 z + x0) / ((z - 1) (z - p))."""
    ratio = damping * sample_time / mass
    if ratio < 1e-6:
        return np.full(2, 0.5 * sample_time**2 / mass)
    lost = -math.expm1(-ratio)  # 1 - exp(-ratio) would round a small ratio away
    return np.array([ratio - lost, lost - ratio * (1.0 - lost)]) * mass / damping**2


def _last_stable(is_stable: Callable[[float], bool], step: float) -> float:
    """Return the last stable value from zero in the direction of `step`, to six digits; infinite beyond 1e6 steps."""
    inside, outside = 0.0, 1e-3 * step
    while is_stable(outside):
        inside, outside = outside, 1.1 * outside
        if abs(outside) > 1e6 * abs(step):
            return math.copysign(math.inf, step)
    for _ in range(40):
        middle = 0.5 * (inside + outside)
        inside, outside = (middle, outside) if is_stable(middle) else (inside, middle)
    return float(f"{inside:.6g}")
