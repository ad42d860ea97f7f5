"""Every algorithm on the hard cases: who gives energy out, and what is left of the wall?

The scenes of `configs/hard` that render something, at five rates and two delays, each with its own user and plant; the
plant judges the energy. Then the K-B plot of one rig: over the damping of a wall the stiffness up to which it is
passive, and the largest of these that is rendered within 5 %. Nothing here depends on the speed of the machine.
"""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from canhaptic.control.balance import PASSIVE_TOLERANCE
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.passivity import ALGORITHMS
from canhaptic.errors import InputError, ParameterError
from canhaptic.scene.load import load_scene
from canhaptic.scene.models import Scene
from canhaptic.study.algorithms import able_under
from canhaptic.study.field_figures import (
    drag,
    energy_beyond_device,
    energy_given_out,
    rate_hardness,
    stiffest,
    stiffness_grid,
)
from canhaptic.study.figures import figures
from canhaptic.study.loop import LoopRun, Recorder, render
from canhaptic.study.map.z_width import colgate_stiffness
from canhaptic.study.reference.continuous_reference import ContinuousReference, continuous_reference
from canhaptic.study.scenes import at_rate, cycles_of, environment_of, loop_case, plant_parts
from tools.bench.report import DEFAULT_OUT, Row, picture_place, publish, write_result
from tools.bench.standard_cases import PLANT, USER_S, standard_case

HARD: Final = Path(__file__).resolve().parents[2] / "configs" / "hard"
RATES: Final = (100.0, 300.0, 1000.0, 3000.0, 8000.0)
LONGEST: Final = 2.0  # [s] of one run
DAMPINGS: Final = (0.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0)  # [N*s/m] of the K-B plot
STIFFNESSES: Final = stiffness_grid(1e2, 1e6, 6)  # [N/m]
AT_DAMPING: Final = 10.0  # [N*s/m]
RIG_RATE: Final = 1000.0
NEAR: Final = 0.05
_PACKAGES: Final = ("canhaptic", "numpy")
Entry = dict[str, Any]


def hard_scenes() -> list[str]:
    """Returns the names of the scenes that render something; the others are about the plant."""
    paths = sorted(path for path in HARD.glob("*.yaml") if not path.stem.startswith("sim_"))
    return [path.stem for path in paths]


def with_loop(scene: Scene, rate: float, delay: int) -> Scene:
    """Returns a scene at another rate and delay; torques act at their SYNC, as in a loop without a bus."""
    scene = at_rate(scene, rate)
    timing = {"torque_window": 0.0, "sync_jitter": 0.0}
    bus = scene.bus.model_copy(update={"rpdo": "synchronous" if delay else "event"})
    axes = tuple(replace(a, loop=a.loop.model_copy(update={"delay": bus.delay, **timing})) for a in scene.axes)
    return replace(scene, bus=bus, axes=axes)


def reference_of(scene: Scene, cycles: int) -> ContinuousReference | None:
    """Returns the continuous run of a scene; None where there is none."""
    [axis] = scene.axes
    plant, user, effects, seed = plant_parts(axis)
    try:
        return continuous_reference(environment_of(axis), plant, user, effects, scene.bus.sample_time_ns, cycles, seed)
    except InputError:
        return None


def entries() -> Iterator[Entry]:
    """Yields the figures of every algorithm in every case."""
    for name in hard_scenes():
        scene = load_scene(HARD / f"{name}.yaml")
        for rate in RATES:
            cycles = cycles_of(at_rate(scene, rate), min(LONGEST, scene.run.duration or LONGEST))
            reference = reference_of(at_rate(scene, rate), cycles)
            for delay in (0, 1):
                for algorithm in ALGORITHMS:
                    found = entry(with_loop(scene, rate, delay), algorithm, cycles, reference)
                    yield {"scene": name, "rate": rate, "delay": delay, "algorithm": algorithm, **found}
        print(f"{name}: done", flush=True)


def entry(scene: Scene, algorithm: str, cycles: int, reference: ContinuousReference | None) -> Entry:
    """Returns the figures of one run; only its status where it could not be built."""
    [axis] = scene.axes
    try:
        case = loop_case(able_under(axis, algorithm, scene).axis, scene)
        run = render(case, cycles, None if reference is None else Recorder.around(reference.position))
    except ParameterError:
        return {"status": "refused"}
    return {"status": run.ended or "completed", **of_run(run, scene, reference)}


def of_run(run: LoopRun, scene: Scene, reference: ContinuousReference | None) -> Entry:
    """Returns the figures of a run, to four digits."""
    environment, sample_time = environment_of(scene.axes[0]), scene.bus.sample_time
    found = figures(environment, run, reference, sample_time)
    stiffness = getattr(environment, "stiffness", None)
    device_damping = scene.axes[0].loop.device_damping or 0.0
    hardness = rate_hardness(run, environment, sample_time)
    values: dict[str, float | None] = {
        "energy_given_out": energy_given_out(run),
        "energy_beyond_device": energy_beyond_device(run, device_damping, sample_time),
        "position_error": part(found, "position_error", "rms"),
        "travel": None if reference is None else reference.travel,
        "force_variation": part(found, "force_variation", "ratio"),
        "stiffness_rendered": part(found, "stiffness_rendered", "share"),
        "rate_hardness": hardness / stiffness if hardness is not None and stiffness else None,
        "limit_cycle": found["limit_cycle"],
        "drag": drag(run),
    }
    certificate = {"certificate": run.summary.certificate.name.lower()}
    return certificate | {name: None if value is None else rounded(value) for name, value in values.items()}


def part(found: Mapping[str, Any], group: str, name: str) -> float | None:
    """Returns one figure of a group; None where the group could not be measured."""
    return None if found[group] is None else found[group][name]


def summary(table: Sequence[Entry]) -> list[Row]:
    """Returns one row per algorithm and figure, and the rank of `guarded` in each where less is better."""
    rows, ranks = [], []
    for figure, (unit, value_of) in FIGURES.items():
        values = {}
        for name in ALGORITHMS:
            built = [e for e in table if e["algorithm"] == name and e["status"] != "refused"]
            values[name] = value_of(built)
        rows += [Row(f"{name}: {figure}", value, unit) for name, value in values.items()]
        if not figure.startswith("rate-hardness"):
            better = sum(value < values["guarded"] for value in values.values())
            ranks.append(Row(f"rank of guarded among {len(values)}: {figure}", 1 + better, "1"))
    return rows + ranks


def most_given_out(built: Sequence[Entry]) -> float:
    """Returns the most energy given out by a run that was completed."""
    return max((e["energy_given_out"] for e in built if e["status"] == "completed"), default=0.0)


def whole(built: Sequence[Entry], *figures_asked: str) -> list[Entry]:
    """Returns the runs that were completed and have the figures asked for."""
    return [e for e in built if e["status"] == "completed" and all(e[f] is not None for f in figures_asked)]


def middle(values: Iterator[float]) -> float:
    """Returns the median, to four digits."""
    return rounded(float(np.median(list(values))))


FIGURES: Final[dict[str, tuple[str, Callable[[Sequence[Entry]], float]]]] = {
    "cases that gave out more than 1 uJ": ("1", lambda b: sum(e["energy_given_out"] > PASSIVE_TOLERANCE for e in b)),
    "cases that gave out more than 1 uJ beyond what the device takes": (
        "1",
        lambda b: sum(e["energy_beyond_device"] > PASSIVE_TOLERANCE for e in b),
    ),
    "most energy given out, completed runs": ("J", most_given_out),
    "runs that diverged": ("1", lambda b: sum(e["status"] == "diverged" for e in b)),
    "position error rms over travel, median": (
        "1",
        lambda b: middle(e["position_error"] / e["travel"] for e in whole(b, "position_error", "travel")),
    ),
    "force variation over the continuous one, median": (
        "1",
        lambda b: middle(e["force_variation"] for e in whole(b, "force_variation")),
    ),
    "stiffness rendered less 1, median size": (
        "1",
        lambda b: middle(abs(e["stiffness_rendered"] - 1.0) for e in whole(b, "stiffness_rendered")),
    ),
    "rate-hardness over stiffness, median": (
        "1",
        lambda b: middle(e["rate_hardness"] for e in whole(b, "rate_hardness")),
    ),
    "drag in free motion, mean": ("N", lambda b: rounded(float(np.mean([e["drag"] for e in whole(b, "drag")])))),
}


def borders() -> list[Entry]:
    """Returns the K-B plot: for each algorithm and damping the border of passive walls and the stiffest near one."""
    found = []
    for algorithm in ALGORITHMS:
        for damping in DAMPINGS:
            near_at: list[float] = []

            def passes(stiffness: float, *, near_at: list[float] = near_at, algorithm: str = algorithm,
                       damping: float = damping) -> bool:  # fmt: skip
                passive, near = judged(algorithm, stiffness, damping)
                if near:
                    near_at.append(stiffness)
                return passive

            passive = stiffest(passes, STIFFNESSES.tolist())
            found.append(
                {
                    "algorithm": algorithm,
                    "damping": damping,
                    "passive": rounded(passive),
                    "near": rounded(max(near_at, default=0.0)),
                }
            )
    return found


def border_rows(found: Sequence[Entry]) -> list[Row]:
    """Returns the borders at one damping, as rows."""
    return [
        Row(f"{e['algorithm']}: stiffest {word} wall of {AT_DAMPING:g} N*s/m", e[judgement], "N/m")
        for judgement, word in (("passive", "passive"), ("near", "passive and near"))
        for e in found
        if e["damping"] == AT_DAMPING
    ]


def rounded(value: float) -> float:
    """Returns a value to four digits."""
    return float(f"{value:.4g}")


def judged(algorithm: str, stiffness: float, damping: float) -> tuple[bool, bool]:
    """Returns whether a wall on the rig is passive, and whether its stiffness is rendered within 5 %."""
    wall = SpringDamperWall(stiffness=stiffness, damping=damping)
    named: dict[str, Any] = {"declared_damping": PLANT.damping} if algorithm == "energy_bounding" else {}
    run = render(standard_case(wall, algorithm, RIG_RATE, USER_S, **named), round(2.0 * RIG_RATE))
    if run.ended or energy_given_out(run) > PASSIVE_TOLERANCE:
        return False, False
    share = part(figures(wall, run, None, 1.0 / RIG_RATE), "stiffness_rendered", "share")
    return True, share is not None and abs(share - 1.0) <= NEAR


def draw(found: Sequence[Entry]) -> None:
    """Draws the K-B plot of all algorithms with Colgate's bound for the plain spring."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, panels = plt.subplots(1, 2, figsize=(11.0, 4.6), sharex=True, sharey=True, layout="constrained")
    marks = "osv^<>DPX*hp8"
    for panel, judgement, title in zip(panels, ("passive", "near"), ("passive", "passive and within 5 %"), strict=True):
        for number, name in enumerate(ALGORITHMS):
            own = [e for e in found if e["algorithm"] == name]
            values = [e[judgement] if e[judgement] > 0.0 else np.nan for e in own]
            style: dict[str, Any] = {"linewidth": 2.5, "color": "black"} if name == "guarded" else {"linewidth": 1.0}
            places = [e["damping"] for e in own]
            panel.plot(places, values, marker=marks[number], markersize=5, fillstyle="none", label=name, **style)
        bound = colgate_stiffness(PLANT.damping, 0.0, 1.0 / RIG_RATE, 0)
        panel.plot([0.0], [bound], "k+", markersize=10, label="Colgate, plain spring")
        panel.set(title=title, xlabel="damping of the wall [N*s/m]", yscale="log")
        panel.set_xscale("symlog", linthresh=2.0)
        panel.set_xlim(left=-0.3)
        panel.grid(visible=True, alpha=0.3)
    panels[0].set_ylabel("stiffest wall [N/m]")
    panels[1].legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8)
    figure.savefig(picture_place("arena_kb.png"), dpi=110)


def main() -> None:
    """Runs every case, draws the K-B plot and publishes."""
    found = borders()
    if "--no-picture" not in sys.argv:
        draw(found)
    table = list(entries())
    publish("arena", [*summary(table), *border_rows(found)], _PACKAGES, {"borders": found})
    write_result(DEFAULT_OUT / "arena_cases.json", _PACKAGES, {"cases": table})  # large: never recorded


if __name__ == "__main__":
    main()
