"""Published rigs, our number next to theirs; and each rival's own claim on its own ground.

The scenes are those of `configs/published`, whose first lines say what of each paper was read. No parameter is fitted
to a published number. One that the paper does not give is assumed, and our number is given over its range.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any, Final

import numpy as np

from canhaptic.files import shipped
from canhaptic.lab.batch.scalar import render, run_case
from canhaptic.lab.figures.figures import m_width
from canhaptic.lab.loop.axis_loop import LoopRun, environment_of, loop_case
from canhaptic.lab.studies.arena import rounded, with_loop
from canhaptic.lab.studies.map import colgate_stiffness
from canhaptic.scene.far_side import build_plant
from canhaptic.scene.load import load_scene
from canhaptic.scene.method import simulation_of
from canhaptic.scene.models import Scene
from tools.bench.report import Row, publish

_PACKAGES: Final = ("canhaptic", "numpy")
_PUBLISHED: Final = shipped("configs") / "published"
_DEGREE: Final = np.pi / 180.0
_ASSUMED: Final = "The device is assumed."
_TARGET: Final = "within 20 %"
_WITHIN: Final = 0.2
"""Part by which our number may differ from theirs and yet be called met."""
_STILL: Final = 5e-6
"""Motion to and fro that counts as rest, at least [m or rad]."""
_HOLDS: Final = 1000
_DECAYS: Final = 0.95
"""Part of its swing that is left of a ringing which decays, within three fifths of a run."""
Setting = Mapping[str, float]


def scene_of(name: str, values: Setting, *more: str) -> Scene:
    """Returns a published scene with other values."""
    scene = load_scene(_PUBLISHED / f"{name}.yaml", [*(f"{key}={value!r}" for key, value in values.items()), *more])
    return with_loop(scene, scene.bus.rate, scene.bus.delay)


def run_of(scene: Scene, stiffness: float, rate: float | None = None) -> LoopRun:
    """Returns a run of a scene at another stiffness [N/m or N*m/rad], and at a rate [Hz] that no bus need carry."""
    [axis] = scene.axes
    wall = axis.environment.parameters.model_copy(update={"stiffness": stiffness})
    axis = replace(axis, environment=axis.environment._replace(parameters=wall))
    step = scene.bus.sample_time_ns if rate is None else round(1e9 / rate)
    simulation, loop = simulation_of(axis), axis.loop.model_copy(update={"sample_time": step * 1e-9})
    case = replace(
        loop_case(axis, scene), loop=loop, sample_time_ns=step, make_plant=lambda: build_plant(simulation, step)
    )
    return render(case, round((scene.run.duration or 1.0) * 1e9 / step))


def is_quiet(scene: Scene, stiffness: float, rate: float | None) -> bool:
    """Returns whether a handle that leans on a wall comes to rest there: a ringing that decays counts as rest."""
    run, count = run_of(scene, stiffness, rate), 1.0 / scene.axes[0].parameters.counts_per_unit
    if run.ended:
        return False
    fifth = len(run.true_position) // 5
    before, last = (float(np.ptp(run.true_position[part])) for part in (slice(fifth, 2 * fifth), slice(-fifth, None)))
    touches = all(environment_of(scene.axes[0]).contact(q) for q in run.true_position[-fifth:].tolist())
    return last <= max(_STILL, 2.0 * count) or (touches and last < _DECAYS * before)


def stiffest_quiet(scene: Scene, low: float, high: float, rate: float | None = None) -> float:
    """Returns up to which stiffness a handle comes to rest, within 3 %; the lower end where not even that does."""
    while high > 1.03 * low:
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if is_quiet(scene, middle, rate) else (low, middle)
    return low


def over(ranges: Mapping[str, Sequence[float]], figure: Callable[[Setting], float]) -> tuple[float, float]:
    """Returns the least and the largest of a figure over every corner of the ranges of assumed values."""
    found = [figure(dict(zip(ranges, corner, strict=True))) for corner in product(*ranges.values())]
    return rounded(min(found)), rounded(max(found))


def row(
    what: str, ours: float, unit: str, theirs: float, source: str, note: str, span: tuple[float, float] | None = None
) -> Row:
    """Returns our number next to theirs.

    Where values are assumed, `span` is ours over their ranges, and what counts is whether theirs lies inside: a middle
    that was chosen by somebody who knew their number is no evidence.
    """
    ratio = rounded(ours / theirs)
    if span is None:
        return Row(what, rounded(ours), unit, source, theirs, ratio, _TARGET, abs(ratio - 1.0) <= _WITHIN, note)
    place = "theirs lies inside" if span[0] <= theirs <= span[1] else "theirs lies outside"
    words = f"assumed: {span[0]:.4g} to {span[1]:.4g}, {place}. {note}"
    return Row(what, rounded(ours), unit, source, theirs, ratio, note=words)


def choi_tan() -> list[Row]:
    """The stiffest quiet surface at 250 Hz and 40 kHz, and how much stiffer it gets."""
    ranges = {
        "simulation.plant.mass": (0.05, 0.2),
        "simulation.user.damping": (0.4, 1.9),
    }
    lags = (3e-4, 3e-3)

    def stiffest(rate: float, values: Setting, lag: float = 1e-3) -> float:
        effect = f"simulation.effects=[{{type: current_loop, time_constant: {lag!r}}}]"
        return stiffest_quiet(scene_of("choi_tan_2004", values, effect), 50.0, 2e4, rate)

    def span(rate: float) -> tuple[float, float]:
        ends = [over(ranges, partial(stiffest, rate, lag=lag)) for lag in lags]
        return min(low for low, _ in ends), max(high for _, high in ends)

    slow, fast = (stiffest(rate, {}) for rate in (250.0, 40e3))
    ratios = [stiffest(40e3, {}, lag) / stiffest(250.0, {}, lag) for lag in lags]
    source = "Choi and Tan 2004"
    colgate = "Colgate's bound alone would rise 160 times with the rate; a lag that no rate takes away ends the rise"
    return [
        row("texture at 250 Hz, stiffest without buzzing", slow, "N/m", 325.0, source, _ASSUMED, span(250.0)),
        row("texture at 40 kHz, stiffest without buzzing", fast, "N/m", 904.0, source, _ASSUMED, span(40e3)),
        row("texture, 40 kHz over 250 Hz", fast / slow, "1", 904.0 / 325.0, source,
            f"{colgate}.", (rounded(min(ratios)), rounded(max(ratios)))),
    ]  # fmt: skip


def abbott_okamura() -> list[Row]:
    """Where the worst hands make a spring wall active, over the lesser of 2 b / T and 2 f_c / count."""
    rows = []
    for friction, count, damping, rate in ((0.1, 1e-4, 0.1, 100.0), (0.02, 1e-4, 4.0, 100.0), (1.0, 1e-5, 5.0, 400.0)):
        theirs = min(2.0 * damping * rate, 2.0 * friction / count)
        decides = "2 b / T" if 2.0 * damping * rate < 2.0 * friction / count else "2 f_c / count"
        ours = _active_from(friction, count, damping, rate, theirs)
        what = f"spring wall, {decides} decides: {friction:g} N, {count:g} m, {damping:g} N*s/m, {rate:g} Hz"
        rows.append(row(what, ours, "N/m", theirs, "Abbott and Okamura 2005", "Their formula."))
    return rows


def _active_from(friction: float, count: float, damping: float, rate: float, near: float) -> float:
    """Returns the stiffness up to which the worst hands draw no energy that the device does not take [N/m]."""

    def passes(stiffness: float) -> bool:
        swings = (0.01 * count, 400.0 * count)  # to and fro over the edge of a count, and far to and fro
        return all(_is_covered(stiffness, friction, count, damping, rate, swing) for swing in swings)

    low, high = 0.5 * near, 2.0 * near
    while high > 1.005 * low:
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if passes(middle) else (low, middle)
    return rounded(low)


def _is_covered(stiffness: float, friction: float, count: float, damping: float, rate: float, swing: float) -> bool:
    """Returns whether what a hand gets that turns at every SYNC is covered by the dissipation of the device."""
    middle = -1.5 * count if swing < count else -1.5 * swing
    motion = f"{{amplitude: {swing!r}, frequency: {0.5 * rate!r}, phase: -1.5707963267948966, offset: {middle!r}}}"
    values = {
        "bus.rate": rate, "axes.0.counts_per_unit": 1.0 / count, "environment.stiffness": stiffness,
        "simulation.plant.damping": damping, "simulation.plant.initial_position": middle - swing,
    }  # fmt: skip
    more = (
        f"simulation.user={{stiffness: 1e7, damping: 1000, motion: {motion}}}",
        f"simulation.effects=[{{type: coulomb_friction, static: {friction!r}, kinetic: {friction!r}}}]",
    )
    scene = scene_of("abbott_okamura_2005", values, *more)
    case = replace(loop_case(scene.axes[0], scene), torque_quantum=None, torque_limit=None)
    found = run_case(case, _HOLDS, ["least_covered", "interaction", "diverged"])
    return found["diverged"] == 0.0 and found["least_covered"] >= -1e-3 * abs(found["interaction"])


def diolaiti() -> list[Row]:
    """Up to which stiffness a Phantom comes to rest by its dry friction, over what passivity permits."""
    scene = scene_of("diolaiti_2006", {})
    [axis] = scene.axes
    colgate = colgate_stiffness(0.01, 0.0, scene.bus.sample_time, 0)
    ranges = {"simulation.plant.mass": (0.05, 0.1)}
    dry = "simulation.effects=[{{type: coulomb_friction, static: {0!r}, kinetic: {0!r}}}]".format

    def stiffest(values: Setting, friction: float = 0.04, depth: float = 6e-5) -> float:
        released = {**values, "simulation.plant.initial_position": depth}
        return stiffest_quiet(scene_of("diolaiti_2006", released, dry(friction)), 10.0, 1e5)

    ours, deep = stiffest({}), stiffest({}, depth=1e-3)
    ends = [over(ranges, partial(stiffest, friction=friction)) for friction in (0.02, 0.08)]
    span = min(low for low, _ in ends), max(high for _, high in ends)
    quantised = 2.0 * 0.04 * axis.parameters.counts_per_unit
    note = (
        f"They say that common devices come to rest above what passivity permits ({colgate:.3g} N/m), and that regions "
        f"differ by how far it moves: seen, {deep:.3g} N/m from 1 mm deep."
    )
    return [
        row("Phantom released two counts deep, stiffest wall at rest, against 2 f_c / count", ours, "N/m",
            rounded(quantised), "Diolaiti et al. 2006", note, span)
    ]  # fmt: skip


def elbow() -> list[Row]:
    """The stiffest stable wall behind a torque of 3.7 Hz."""
    ranges = {"simulation.plant.mass": (0.05, 0.15), "simulation.user.damping": (0.2, 1.4)}

    def stiffest(values: Setting) -> float:
        return stiffest_quiet(scene_of("elbow_exoskeleton", values), 0.5, 1e3) * _DEGREE

    note = "Inertia and damping of the arm are assumed; the lag alone is theirs."
    return [
        row("elbow exoskeleton, stiffest stable wall", stiffest({}), "N*m/deg", 0.45, "Chen, Casas and Lum 2019",
            note, over(ranges, stiffest))
    ]  # fmt: skip


def displayed(run: LoopRun) -> float:
    """Returns the stiffness displayed in the last presses: largest force over largest depth there [N/m]."""
    last = slice(len(run.position) // 2, None)
    depth = -float(run.true_position[last].min())
    return float(run.torque[last].max()) / depth if depth > 0.0 else 0.0


def augmentation() -> list[Row]:
    """What force augmentation and others display of 10 N/mm on a Phantom Premium 1.5."""
    ranges = {
        "simulation.plant.mass": (0.05, 0.1),
        "simulation.user.damping": (1.0, 5.0),
        "simulation.user.motion.offset": (-7e-3, -20e-3),
    }
    known = "moving_mass: 0.05, device_damping_bound: 0.02, device_friction_bound: 0.08, hand_push: 8"
    algorithms = {
        "force_augmentation": "passivity.algorithm=force_augmentation",
        "unprotected": "passivity={algorithm: unprotected}",
        "guarded, hand force 0": f"passivity={{algorithm: guarded, {known}, hand_force: 0}}",
        "guarded, hand force 1 N": f"passivity={{algorithm: guarded, {known}, hand_force: 1}}",
    }
    rows = []
    for name, chosen in algorithms.items():

        def shown(values: Setting, chosen: str = chosen) -> float:
            return displayed(run_of(scene_of("phantom_premium_15", values, chosen), 10e3))

        run = run_of(scene_of("phantom_premium_15", {}, chosen), 10e3)
        note = f"{1e3 * max(0.0, -run.least_interaction):.3g} mJ given out. Device and hand are assumed."
        what = f"Phantom Premium 1.5, 10 N/mm asked, displayed by {name}"
        rows.append(row(what, displayed(run), "N/m", 10e3, "Singh, Jafari and Ryu 2019", note, over(ranges, shown)))
    return rows


def virtual_mass() -> list[Row]:
    """The M-width without damping, next to what is said of it in the units of the device's mass."""
    most = m_width(0.25, 0.0, 1e-3).most / 0.25
    note = 'Cited as "roughly 2x the device\'s own effective mass"; their own figures were not seen.'
    source = "Gil et al. 2020; M-width: Colonnese and Okamura 2015"
    return [row("largest virtual mass over that of the device", most, "1", 2.0, source, note)]


def main() -> None:
    """Runs every rig and publishes."""
    rows: list[Row] = []
    parts: tuple[Callable[[], list[Row]], ...] = (
        choi_tan, abbott_okamura, diolaiti, augmentation, elbow, virtual_mass,
    )  # fmt: skip
    for part in parts:
        rows += part()
        print(f"{part.__name__}: done", flush=True)
    more: dict[str, Any] = {"within": _WITHIN}
    publish("published", rows, _PACKAGES, more)


if __name__ == "__main__":
    main()
