"""Benchmark of passivity algorithms (the arena): demanding scenes at several rates and delays, then a ranking.

A case is one algorithm on one scene at one rate and delay, run without a bus (`figures_of_part`). Workers compute the
cases and `ArenaStore` keeps them, so that a stopped arena can be resumed. A stored case is reused only if its scene,
rate, delay, algorithm, duration, and all code that computes it are unchanged.

On one rig the arena also measures the K-B plot, the impedance and the time of a step of every algorithm, and the
M-width. In the K-B plot a wall counts as passive if the display with its device is: after every hold the net energy
given out is at most the certain dissipation by damping and friction of the device, and at least a tenth of the wall is
rendered. Colgate's condition demands this for every hand; here one hand moves in and out of the wall. So an algorithm
may pass above Colgate's line, and none may fail below it.

The ranking has one row per algorithm with its figures over all cases, its rank in each figure, and the scenes in which
it gives out energy.
"""

import hashlib
import json
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, partial
from importlib.metadata import version
from itertools import product
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.passivity import ALGORITHMS
from canhaptic.control.verdict import PASSIVE_TOLERANCE
from canhaptic.errors import InputError, ParameterError
from canhaptic.files import read_regular, shipped
from canhaptic.lab.batch.cases import why_not_batchable
from canhaptic.lab.batch.marching import run_batch
from canhaptic.lab.batch.scalar import render, run_scalar
from canhaptic.lab.batch.varied import scene_with
from canhaptic.lab.figures import figures as run_figures
from canhaptic.lab.figures.figures import OUTCOME_METRICS, OUTCOMES, outcomes
from canhaptic.lab.loop import axis_loop
from canhaptic.lab.loop.axis_loop import Array
from canhaptic.lab.reference import ContinuousReference
from canhaptic.lab.studies import Row
from canhaptic.lab.studies.compare import reference_of, run_axis
from canhaptic.lab.studies.map import theory_of
from canhaptic.lab.studies.runner import Count, Job, Progress, run_jobs
from canhaptic.lab.studies.store import Store, create_store
from canhaptic.scene.components import ComponentSpec
from canhaptic.scene.load import MAX_BYTES, load_scene, scene_from_text
from canhaptic.scene.method import simulation_of
from canhaptic.scene.models import Scene
from canhaptic.sim.plant.user import SinusoidMotion, UserParameters

_MARK: Final = ".py:"
_OF_THE_PLANT: Final = "sim_"
"""Prefix of scenes that only test the simulated plant and render nothing."""


def scenes_named(names: Sequence[str] | None) -> list[Path]:
    """Return the files of scenes, given by name in `configs/hard` or by path; None: all that render an environment.

    Raises:
        InputError: A name is neither a scene in `configs/hard` nor a file.
    """
    folder = shipped("configs") / "hard"
    hard = {path.stem: path for path in sorted(folder.glob("*.yaml"))}
    if names is None:
        return [path for name, path in hard.items() if not name.startswith(_OF_THE_PLANT)]
    unknown = [name for name in names if name not in hard and not Path(name).is_file()]
    if unknown:
        raise InputError(f"--scenes: {unknown[0]!r} is not a file, nor one of: {', '.join(hard)}")
    return [hard.get(name, Path(name)) for name in names]


def label_of(algorithm: str) -> str:
    """Return the name of an algorithm in results; of a user-defined algorithm `FILE.py:Class` without its folder."""
    return Path(algorithm).name if is_own(algorithm) else algorithm


def is_own(algorithm: str) -> bool:
    """Whether an algorithm is user-defined, named as `FILE.py:Class`."""
    return _MARK in algorithm


def entry_of(reference: str, path: Path, allow_code: bool) -> ComponentSpec:
    """Return the user-defined algorithm `FILE.py:Class` as the `passivity` of a scene.

    Args:
        reference: File and class.
        path: Path of the scene, whose parameters the algorithm takes over.
        allow_code: Whether the file may run.

    Raises:
        InputError: The file may not run, or the class is not an algorithm.
    """
    file, _, name = reference.partition(":")
    own = Path(file).resolve()
    text, source = read_regular(path, MAX_BYTES).decode("utf-8"), str(own.with_name(path.name))
    algorithm = f"passivity={{algorithm: {own.name}:{name}}}"
    return scene_from_text(text, source, [algorithm], allow_code=allow_code).axes[0].passivity


def scene_under(path: Path, algorithm: str, *, allow_code: bool = False) -> Scene:
    """Return a scene of one axis under an algorithm; properties that it needs and lacks are taken from the plant.

    Raises:
        InputError: The scene has groups or several axes, or user-defined code may not run.
        ParameterError: The algorithm refuses the scene.
    """
    scene = load_scene(path, allow_code=allow_code)
    axis_loop.require_single_axes(scene, "arena")
    if len(scene.axes) != 1:
        raise InputError(f"{path}: has {len(scene.axes)} axes, expected one; make a scene of each")
    if is_own(algorithm):
        own = entry_of(algorithm, path, allow_code)
        scene = replace(scene, axes=(replace(scene.axes[0], passivity=own),))
        algorithm = own.name
    return axis_loop.under(scene, algorithm).permitted()


def with_loop(scene: Scene, rate: float, delay: int) -> Scene:
    """Return a scene at another rate [Hz] and delay; torques act exactly at a SYNC, as in a loop without a bus."""
    scene = axis_loop.at_rate(scene, rate)
    timing = {"torque_window": 0.0, "sync_jitter": 0.0}
    bus = scene.bus.model_copy(update={"rpdo": "synchronous" if delay else "event"})
    axes = tuple(replace(a, loop=a.loop.model_copy(update={"delay": bus.delay, **timing})) for a in scene.axes)
    return replace(scene, bus=bus, axes=axes)


def figures_of_part(part: "ArenaPlan", known: Collection[tuple[int, str]] = ()) -> list[Row]:
    """Return the figures of every case of a plan with one scene and one rate.

    Args:
        part: The plan; its cases share one continuous run.
        known: (delay, algorithm label) of cases to omit.
    """
    asked = [(d, name) for d in part.delays for name in part.algorithms if (d, label_of(name)) not in known]
    if not asked:
        return []
    [path], [rate] = part.scenes, part.rates
    plain = axis_loop.at_rate(load_scene(path, allow_code=part.allow_code), rate)
    cycles = axis_loop.cycles_of(plain, min(part.longest, plain.run.duration or part.longest))
    reference, _ = reference_of(plain, cycles)
    found = []
    for delay, name in asked:
        case = {"scene": path.stem, "rate": rate, "delay": delay, "algorithm": label_of(name)}
        try:
            scene = with_loop(scene_under(path, name, allow_code=part.allow_code), rate, delay)
            found.append(case | _figures_of(scene, cycles, reference))
        except ParameterError as error:
            found.append(case | {"status": "refused", "remark": str(error).splitlines()[0]})
    return found


def _figures_of(scene: Scene, cycles: int, reference: ContinuousReference | None) -> Row:
    """Return the figures of a run, to four digits."""
    [axis], environment, sample_time = scene.axes, axis_loop.environment_of(scene.axes[0]), scene.bus.sample_time
    run = run_axis(scene, reference, cycles)
    found = run_figures.figures(environment, run, reference, sample_time, axis.parameters.torque_limit)
    stiffness = getattr(environment, "stiffness", None)
    hardness = run_figures.rate_hardness(run, environment, sample_time)
    error, share = found["position_error.rms"], found["stiffness_rendered.share"]
    travel = None if reference is None else reference.travel
    values: dict[str, float | None] = {
        "energy_given_out": run_figures.energy_given_out(run),
        "energy_beyond_device": run_figures.energy_beyond_device(run, axis.loop.device_damping or 0.0, sample_time),
        "position_error": error / travel if error is not None and travel else None,
        "force_variation": found["force_ripple.ratio"],
        "stiffness_error": None if share is None else abs(share - 1.0),
        "rate_hardness": hardness / stiffness if hardness is not None and stiffness else None,
        "limit_cycle": found["limit_cycle"],
        "drag": run_figures.drag(run),
    }
    ended = run.ended or found["outcome"] or "completed"
    status = {"status": ended, "certificate": run.summary.certificate.name.lower()}
    return status | {name: None if value is None else rounded(value) for name, value in values.items()}


def rounded(value: float) -> float:
    """Return a value rounded to four digits."""
    return float(f"{value:.4g}")


DAMPINGS: Final = (0.0, 0.05, 0.1, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0)  # [N*s/m]
_STIFFNESSES: Final = (1e2, 1e6)  # [N/m]
FREQUENCIES: Final = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)  # [Hz]
_SPRING: Final = SpringDamperWall(stiffness=1000.0, damping=5.0)
"""Environment of the impedance measurement; the hand moves around `_PRESS`, so that it never leaves contact."""
_HAND: Final = UserParameters(stiffness=2000.0, damping=20.0)
_AMPLITUDE: Final = 5e-3  # [m]
_PRESS: Final = -0.05  # mean position of the hand [m]
_METRICS: Final = ("diverged", "least_covered", "stiffness_rendered.share", *OUTCOME_METRICS)
_RATES: Final = (100.0, 300.0, 1000.0, 3000.0, 8000.0)
"""Rates of the M-width [Hz]."""
_REPEATS: Final = 5
Rows = list[Row]


def tried_stiffnesses(per_decade: int) -> Array:
    """Return the stiffnesses of the K-B plot, evenly spaced in the logarithm, ends included, shape (n,) [N/m]."""
    least, most = _STIFFNESSES
    return np.geomspace(least, most, 1 + round(per_decade * np.log10(most / least)))


def on_rig(rig: Path, algorithm: str, delay: int, *, allow_code: bool = False) -> Scene:
    """Return the rig under an algorithm at a delay; errors as of `scene_under`.

    Args:
        rig: Scene of one axis with a wall.
        algorithm: Name, or `FILE.py:Class`.
        delay: Whole holds, 0 or 1.
        allow_code: Whether the file may run.
    """
    scene = scene_under(rig, algorithm, allow_code=allow_code)
    return with_loop(scene, scene.bus.rate, delay)


def borders(scene: Scene, per_decade: int) -> Rows:
    """Return the K-B plot of a rig: for each damping, the stiffest passive wall and the stiffest accurate one.

    Args:
        scene: Rig under an algorithm.
        per_decade: Number of stiffnesses per decade.
    """
    stiffnesses = tried_stiffnesses(per_decade)
    walls = {
        "environment.stiffness": np.repeat(stiffnesses, len(DAMPINGS)),
        "environment.damping": np.tile(DAMPINGS, len(stiffnesses)),
    }
    found = {name: values.reshape(-1, len(DAMPINGS)) for name, values in _tried(scene, walls).items()}
    kept = (found["diverged"] == 0.0) & (found["least_covered"] >= -PASSIVE_TOLERANCE)
    kept &= outcomes(found.__getitem__) == 0
    border = run_figures.stiffest_walls(stiffnesses, kept, found["stiffness_rendered.share"])
    return [
        {"damping": damping, "passive": rounded(passive), "near": rounded(near), "open": bool(is_open)}
        for damping, passive, near, is_open in zip(DAMPINGS, *border, strict=True)
    ]


def _tried(scene: Scene, walls: Mapping[str, Array]) -> Mapping[str, Array]:
    """Run walls and return their figures, in a batch if the algorithm has a kernel."""
    cycles = axis_loop.cycles_of(scene, None)
    if not why_not_batchable(scene):
        return run_batch(scene, walls, cycles, metrics=_METRICS)
    rows = (dict(zip(walls, values, strict=True)) for values in np.column_stack([*walls.values()]).tolist())
    found = [run_scalar(scene_with(scene, row), cycles, _METRICS) for row in rows]
    return {name: np.array([one[name] for one in found]) for name in _METRICS}


def theory(rig: Path, delay: int) -> dict[str, Rows]:
    """Return the theoretical limits in the K-B plot: name -> points of damping and stiffness.

    Two limits apply to the plain wall; the third is the largest stiffness that `guarded` certifies. See
    `lab.studies.map`.
    """
    plain, ours = (on_rig(rig, name, delay) for name in ("unprotected", "guarded"))
    device = simulation_of(plain.axes[0]).plant.damping
    fine = [*np.linspace(0.0, device, 21).tolist(), *(damping for damping in DAMPINGS if damping > device)]
    found = {d: theory_of(scene_with(plain, {"environment.damping": d})) for d in fine}
    lines = {
        "Colgate, plain wall": {d: one.colgate for d, one in found.items()},
        "eigenvalues, plain wall": {d: one.eigenvalues for d, one in found.items()},
        "largest certificate of guarded": dict.fromkeys(DAMPINGS, theory_of(ours).certificate),
    }
    return {
        name: [{"damping": rounded(d), "stiffness": rounded(k)} for d, k in line.items() if k]
        for name, line in lines.items()
    }


def impedances(scene: Scene) -> Rows:
    """Return the rendered over the requested impedance of a rig at each of `FREQUENCIES`: magnitude and angle [rad].

    The environment is a spring with a damper, always in contact.
    """
    found = Rows()
    for frequency in FREQUENCIES:
        run, period = _shaken(scene, frequency), scene.bus.sample_time
        asked = run_figures.asked_impedance(_SPRING.stiffness, _SPRING.damping, frequency)
        ratio = complex(np.nan) if run.ended else run_figures.rendered_impedance(run, period, frequency) / asked
        size, angle = (rounded(float(part)) if np.isfinite(part) else None for part in (abs(ratio), np.angle(ratio)))
        found.append({"frequency": frequency, "size": size, "angle": angle})
    return found


def _shaken(scene: Scene, frequency: float) -> axis_loop.LoopRun:
    [axis] = scene.axes
    motion = SinusoidMotion(amplitude=_AMPLITUDE, frequency=frequency, offset=_PRESS)
    user = _HAND.model_copy(update={"motion": motion})
    simulation = replace(simulation_of(axis), user=user)
    environment = ComponentSpec("spring_damper_wall", _SPRING)
    case = axis_loop.loop_case(replace(axis, environment=environment, simulation=simulation), scene)
    return render(case, axis_loop.cycles_of(scene, 2.0))


def times_of_steps(rig: Path, algorithms: Sequence[str], *, allow_code: bool = False) -> dict[str, float]:
    """Return the time of a step [us] of each algorithm on the rig, interleaved; valid for this machine and moment."""
    cases: dict[str, tuple[axis_loop.LoopCase, axis_loop.LoopRun]] = {}
    for name in algorithms:
        with suppress(ParameterError):
            scene = scene_under(rig, name, allow_code=allow_code)
            case = axis_loop.loop_case(scene.axes[0], scene)
            cases[label_of(name)] = case, render(case, axis_loop.cycles_of(scene, None))
    return {name: rounded(time) for name, time in axis_loop.microseconds_per_step(cases, _REPEATS).items()}


def mass_widths(rig: Path) -> Rows:
    """Return the M-width of the rig at several rates and delays; it does not depend on the algorithm."""
    plant = simulation_of(scene_under(rig, "unprotected").axes[0]).plant
    return [
        {"rate": rate, "delay": delay, "least": rounded(width.least), "most": rounded(width.most)}
        for rate, delay in product(_RATES, (0, 1))
        for width in (run_figures.m_width(plant.mass, plant.damping, 1 / rate, delay),)
    ]


class Column(NamedTuple):
    """One column of the ranking: a figure over all cases of an algorithm."""

    value: Callable[[Sequence[Row]], float | None]  # from the cases of an algorithm; None where it does not apply
    is_ranked: bool = True  # whether less is better


_RAN: Final = ("completed", *OUTCOMES[1:])
"""Status of cases that ran to their end."""


def _count(figure: str) -> Callable[[Sequence[Row]], float]:
    return lambda cases: float(sum(case[figure] > PASSIVE_TOLERANCE for case in cases))


def _combined(figure: str, by: Callable[[Sequence[float]], Any] = np.median) -> Callable[[Sequence[Row]], float | None]:
    """Return a function that combines a figure of all cases which ran to their end, for example to its median."""

    def of(cases: Sequence[Row]) -> float | None:
        values = [case[figure] for case in cases if case["status"] in _RAN and case[figure] is not None]
        return rounded(float(by(values))) if values else None

    return of


def _ended(status: str) -> Callable[[Sequence[Row]], float]:
    return lambda cases: float(sum(case["status"] == status for case in cases))


def _most_given_out(cases: Sequence[Row]) -> float:
    return max((case["energy_given_out"] for case in cases if case["status"] in _RAN), default=0.0)


COLUMNS: Final[dict[str, Column]] = {
    "given_out": Column(_count("energy_given_out")),
    "beyond_device": Column(_count("energy_beyond_device")),
    "most_given_out": Column(_most_given_out),
    "diverged": Column(_ended("diverged")),
    "not_rendered": Column(_ended(OUTCOMES[2])),
    "position_error": Column(_combined("position_error")),
    "force_variation": Column(_combined("force_variation")),
    "stiffness_error": Column(_combined("stiffness_error")),
    "limit_cycle": Column(_combined("limit_cycle", np.mean)),
    "rate_hardness": Column(_combined("rate_hardness"), is_ranked=False),
    "drag": Column(_combined("drag", np.mean)),
}
"""Row of `quantities.STANDING` -> figure of the ranking."""


def ranking(algorithms: Sequence[str], cases: Sequence[Row]) -> list[Row]:
    """Return the figures of each algorithm over its cases, one row per algorithm.

    Args:
        algorithms: Names, in the order of the rows.
        cases: Cases of all algorithms.
    """
    rows = []
    for name in algorithms:
        built = [case for case in cases if case["algorithm"] == name and case["status"] != "refused"]
        figures = {key: column.value(built) if built else None for key, column in COLUMNS.items()}
        rows.append({"algorithm": name, "cases": len(built), **figures})
    return rows


def ranks(rows: Sequence[Row]) -> dict[str, dict[str, int]]:
    """Return the rank of each algorithm in each ranked figure: 1 + the number of better algorithms."""
    found: dict[str, dict[str, int]] = {row["algorithm"]: {} for row in rows}
    for key, column in COLUMNS.items():
        known = {row["algorithm"]: row[key] for row in rows if row[key] is not None}
        if column.is_ranked:
            for name, value in known.items():
                found[name][key] = 1 + sum(other < value for other in known.values())
    return found


def given_out(algorithms: Sequence[str], cases: Sequence[Row]) -> dict[str, dict[str, dict[str, float]]]:
    """Return algorithm -> scene -> number of cases that generate more than the device dissipates, and the most [J]."""
    found: dict[str, dict[str, dict[str, float]]] = {name: {} for name in algorithms}
    for case in cases:
        if case["algorithm"] in found and case["status"] != "refused":
            energy = case["energy_beyond_device"]
            of = found[case["algorithm"]].setdefault(case["scene"], {"cases": 0.0, "most": energy})
            of["cases"], of["most"] = of["cases"] + (energy > PASSIVE_TOLERANCE), max(of["most"], energy)
    return found


_KIND: Final = "arena"
_LARGEST: Final = 100_000_000  # largest file of a scene or algorithm [B]
_COMPUTES: Final = ("control", "kernels", "scene", "sim", "lab")
"""Folders of the package whose code determines the result of a case."""


class ArenaStore(Store):
    """Finished cases of an arena on disk.

    Args:
        folder: Folder of the store; created if it does not exist.
        force: Whether to delete stored cases.

    Raises:
        CanHapticError: The folder cannot be read or created.
    """

    def __init__(self, folder: Path, *, force: bool = False) -> None:
        try:
            folder.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{folder.parent}: cannot be created ({error.strerror}); give another --out") from error
        if force or not folder.exists():
            create_store(folder, _KIND, {}, replace=force)
        super().__init__(folder, _KIND, writable=True)

    def finished(self, part: "ArenaPlan") -> list[Row]:
        """Return the stored cases of a part."""
        names = (_key(part, delay, name) for delay in part.delays for name in part.algorithms)
        return [json.loads((self.folder / name).read_text(encoding="utf-8")) for name in names if name in self.chunks]

    def add(self, part: "ArenaPlan", found: Iterable[Row]) -> None:
        """Store cases of a part; they are on the disk on return.

        Raises:
            LogWriteError: The folder cannot be written.
        """
        references = {label_of(name): name for name in part.algorithms}
        for case in found:
            name = _key(part, case["delay"], references[case["algorithm"]])
            self.write(name, json.dumps(case).encode())


def _key(part: "ArenaPlan", delay: int, algorithm: str) -> str:
    own = _hash_of(Path(algorithm.rpartition(":")[0])) if is_own(algorithm) else ""
    parts = [_hash_of(part.scenes[0]), part.rates[0], delay, algorithm, own, part.longest, code_hash()]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:32] + ".json"


def _hash_of(path: Path) -> str:
    return hashlib.sha256(read_regular(path, _LARGEST)).hexdigest()


@cache
def code_hash() -> str:
    """Return a hash of the code that computes the figures."""
    package, digest = Path(__file__).resolve().parents[2], hashlib.sha256()
    for path in sorted(path for folder in _COMPUTES for path in (package / folder).rglob("*.py")):
        digest.update(path.relative_to(package).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()


RATES: Final = (100.0, 300.0, 1000.0, 3000.0, 8000.0)  # [Hz]
DELAYS: Final = (0, 1)
LONGEST: Final = 2.0  # [s] of one run
PER_DECADE: Final = 12
"""Stiffnesses per decade of the K-B plot."""


@dataclass(frozen=True, slots=True)
class ArenaPlan:
    """Scenes, rates, delays and algorithms of an arena.

    Attributes:
        scenes: Files, each with one simulated axis.
        algorithms: Names, or `FILE.py:Class` for user-defined algorithms.
        rates: Rates [Hz].
        delays: Delays in whole holds, 0 or 1.
        longest: Largest duration of a run [s].
        rig: Scene of the K-B plot.
        per_decade: Stiffnesses per decade of the K-B plot; 0: no measurements on the rig.
        allow_code: Whether the named files may run.
    """

    scenes: tuple[Path, ...]
    algorithms: tuple[str, ...] = tuple(ALGORITHMS)
    rates: tuple[float, ...] = RATES
    delays: tuple[int, ...] = DELAYS
    longest: float = LONGEST
    rig: Path = shipped("configs") / "arena_rig.yaml"
    per_decade: int = PER_DECADE
    allow_code: bool = False

    def parts(self) -> list["ArenaPlan"]:
        """Split the plan into one for each scene and rate, whose cases share one continuous run."""
        return [replace(self, scenes=(path,), rates=(rate,)) for path in self.scenes for rate in self.rates]

    @property
    def each(self) -> int:
        """Number of cases of one scene at one rate."""
        return len(self.delays) * len(self.algorithms)

    def names(self) -> list[str]:
        """Return the names of the algorithms in results, each once."""
        return list(dict.fromkeys(map(label_of, self.algorithms)))

    def check(self) -> None:
        """Check every scene and algorithm before anything runs.

        Raises:
            InputError: A scene or an algorithm cannot be used.
        """
        if not (self.scenes and self.algorithms and self.rates and self.delays):
            raise InputError("arena: got no scene, algorithm, rate or delay; leave the option out to take all")
        if not set(self.delays) <= {0, 1}:
            raise InputError(f"arena: got the delays {self.delays}, expected 0 (event) or 1 (synchronous)")
        if len(self.names()) < len(self.algorithms) or len({path.stem for path in self.scenes}) < len(self.scenes):
            raise InputError("arena: two scenes or two algorithms have the same name; rename one of the files")
        axis_loop.chosen_algorithms([name for name in self.algorithms if not is_own(name)] or None)
        for path in self.scenes:
            scene_under(path, "unprotected", allow_code=self.allow_code)
        for name in filter(is_own, self.algorithms):
            entry_of(name, self.scenes[0], self.allow_code)


def run_arena(
    plan: ArenaPlan,
    store: ArenaStore,
    executor: Executor | None = None,
    progress: Callable[[Progress], None] = lambda _: None,
    stop_requested: Callable[[], bool] = lambda: False,
) -> Row | None:
    """Run an arena; return all results as plain values, or None if it was stopped.

    Args:
        plan: Plan of the arena.
        store: Store of finished cases, which are not run again.
        executor: Executor for the parts of the plan; None: this thread.
        progress: Called with the number of finished cases.
        stop_requested: Polled regularly; True stops the arena.

    Raises:
        InputError: A scene, an algorithm or the store cannot be used.
    """
    plan.check()
    parts = plan.parts()
    known = [store.finished(part) for part in parts]
    count = Count(plan.each * len(parts), sum(map(len, known)), progress)
    jobs = [_job(part, of, store) for part, of in zip(parts, known, strict=True)]
    run_jobs(jobs, executor, stop_requested, store.folder, count)
    if count.state.done < count.state.total:
        return None
    cases, names = [case for part in parts for case in store.finished(part)], plan.names()
    found: Row = {
        "canhaptic": version("canhaptic"),
        "code": code_hash(),
        "scenes": [path.stem for path in plan.scenes],
        "algorithms": names,
        "rates": list(plan.rates),
        "delays": list(plan.delays),
        "longest": plan.longest,
        "standings": (rows := ranking(names, cases)),
        "ranks": ranks(rows),
        "given_out": given_out(names, cases),
        "cases": cases,
    }
    return found | (_of_rig(plan, stop_requested) if plan.per_decade else {})


def _job(part: ArenaPlan, finished: Sequence[Row], store: ArenaStore) -> Job:
    """Return the job that runs the cases of a part that are not in the store."""
    known = [(case["delay"], case["algorithm"]) for case in finished]
    what = f"{part.scenes[0].stem} at {part.rates[0]:g} Hz"
    return Job(what, part.each - len(known), figures_of_part, lambda: (part, known), partial(store.add, part))


def _of_rig(plan: ArenaPlan, stop_requested: Callable[[], bool]) -> Row:
    """Return the figures measured on the rig; those after a request to stop are missing."""
    found: dict[str, list[Row]] = {"borders": [], "impedance": []}
    for name, delay in product(plan.algorithms, plan.delays):
        try:
            scene = on_rig(plan.rig, name, delay, allow_code=plan.allow_code)
        except ParameterError:  # the algorithm refuses the rig
            continue
        if not stop_requested():
            case = {"algorithm": label_of(name), "delay": delay}
            found["borders"] += [case | row for row in borders(scene, plan.per_decade)]
            found["impedance"] += [case | row for row in impedances(scene)]
    return {
        "rig": plan.rig.stem,
        **found,
        "theory": {str(delay): theory(plan.rig, delay) for delay in plan.delays},
        "time_of_step": times_of_steps(plan.rig, plan.algorithms, allow_code=plan.allow_code),
        "m_width": mass_widths(plan.rig),
    }
