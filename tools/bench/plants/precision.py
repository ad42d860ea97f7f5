"""Error against time for the easy, the friction and the stiff scene: the points, and the picture of them."""

from collections.abc import Callable, Sequence
from functools import partial
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from tools.bench.plants.scenes import (
    PERIOD,
    Array,
    Scene,
    advance,
    easy,
    friction,
    located,
    reference,
    runge_kutta,
    semi_implicit_euler,
    stiff,
)
from tools.bench.report import picture_place

PICTURE = "work_precision.png"
REPEATS = 3
STYLES = {
    "canhaptic": ("#0b6e4f", "o"),
    "semi-implicit Euler": ("#888888", "v"),
    "RK4": ("#d1495b", "^"),
    "LSODA, events located": ("#30638e", "D"),
}


class Point(NamedTuple):
    """One setting of one method on one scene."""

    scene: str
    method: str
    setting: str
    time: float  # wall time per simulated second, least of the repeats [s]
    error: float  # largest error of the position over its largest size


def points() -> list[Point]:
    """Returns every setting of every method that stays stable."""
    found = []
    for scene in (easy(200), friction(200), stiff(120)):
        expected = reference(scene)
        for method, setting, run in _settings(scene):
            time, got = _least(run)
            error = float(np.abs(got - expected).max() / np.abs(expected).max()) if np.all(np.isfinite(got)) else np.inf
            if error < 1.0:
                seconds = len(scene.torques) * PERIOD
                found.append(Point(scene.name, method, setting, time / seconds, max(error, 1e-16)))
    return found


def _settings(scene: Scene) -> list[tuple[str, str, Callable[[], Array]]]:
    torques = scene.torques.tolist()
    bits = (24,) if scene.name == "easy" else (4, 8, 12, 16, 20, 24)
    runs: list[tuple[str, str, Callable[[], Array]]] = []
    for count in bits:  # of event location
        plant = scene.plant(event_bits=count)
        runs.append(("canhaptic", f"{count} event bits", _again(plant, partial(advance, plant, torques))))
    for substeps in (1, 4, 16, 64, 256):
        name = f"{substeps} substeps"
        runs.append(("semi-implicit Euler", name, partial(semi_implicit_euler, scene, substeps)))
        runs.append(("RK4", name, partial(runge_kutta, scene, substeps)))
    for digits in (3, 5, 7, 9, 11):
        tolerance = 10.0**-digits
        runs.append(
            (
                "LSODA, events located",
                f"rtol 1e-{digits}",
                partial(located, scene, "LSODA", tolerance, tolerance * 1e-3),
            )
        )
    return runs


def _again(plant: Any, run: Callable[[], Array]) -> Callable[[], Array]:
    def fresh() -> Array:
        plant.reset()
        return run()

    return fresh


def _least(run: Callable[[], Array]) -> tuple[float, Array]:
    times = []
    with np.errstate(all="ignore"):
        for _ in range(REPEATS):
            begin = perf_counter()
            try:
                got = run()
            except OverflowError:
                got = np.array([np.inf])
            times.append(perf_counter() - begin)
            if times[-1] > 1.0:
                break
    return min(times), got


def draw(found: Sequence[Point]) -> None:
    """Draws error against time, one panel a scene."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(13.5, 4.8), sharex=True, sharey=True, layout="constrained")
    titles = {
        "easy": "easy: servo and hand, linear",
        "friction": "friction: 0.3 N sliding, 0.5 N static",
        "stiff": "stiff: stop and grip of 1e6 N/m, current loop 50 us",
    }
    for panel, (scene, title) in zip(axes, titles.items(), strict=True):
        for method, (colour, marker) in STYLES.items():
            own = [(p.time * 1e3, p.error) for p in found if (p.scene, p.method) == (scene, method)]
            if own:
                panel.loglog(*zip(*own, strict=True), marker=marker, color=colour, label=method, markersize=6)
        panel.set_title(title, fontsize=10)
        panel.set_xlabel("wall time per simulated second [ms]")
        panel.grid(which="major", alpha=0.3)
        panel.axvline(1e3, color="black", linewidth=0.8, linestyle=":")
    axes[0].set_ylabel("largest position error, relative")
    axes[0].set_ylim(1e-16, 2.0)
    axes[0].text(900, 1.0, "real time", rotation=90, ha="right", va="top", fontsize=8)
    handles, labels = axes[2].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5, frameon=False)
    figure.savefig(picture_place(PICTURE), dpi=130)
    plt.close(figure)
