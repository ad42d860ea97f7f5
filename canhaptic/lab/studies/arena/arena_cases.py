"""Which cases an arena has, and the figures of one: an algorithm on a scene at a rate and a delay, without a bus."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

from canhaptic.errors import InputError, ParameterError
from canhaptic.input_file import read_regular
from canhaptic.lab.figures.field_figures import drag, energy_beyond_device, energy_given_out, rate_hardness
from canhaptic.lab.figures.figures import figures
from canhaptic.lab.loop.algorithms import able_under
from canhaptic.lab.loop.axis_loop import LoopRun, Recorder, render
from canhaptic.lab.loop.scenes import at_rate, cycles_of, environment_of, loop_case, plant_parts, require_single_axes
from canhaptic.lab.reference.continuous_reference import ContinuousReference, continuous_reference
from canhaptic.package_data import shipped
from canhaptic.scene.components import ComponentSpec
from canhaptic.scene.load import MAX_BYTES, load_scene, scene_from_text
from canhaptic.scene.models import Scene

CaseFigures = dict[str, Any]
"""scene, rate, delay, algorithm, status and figures; None where there is nothing to measure."""
_MARK: Final = ".py:"
_OF_THE_PLANT: Final = "sim_"
"""Begins the names of scenes about the plant, which render nothing."""


@dataclass(frozen=True, slots=True)
class CaseGroup:
    """The cases that share one continuous run: a scene at a rate, under every algorithm and delay.

    Attributes:
        path: Path of the scene.
        rate: [Hz].
        delays: 0 or 1 each.
        algorithms: Names, and `FILE.py:Class` of one's own.
        longest: Duration of a run at most [s].
        allow_code: Whether the files named may run.
    """

    path: Path
    rate: float
    delays: tuple[int, ...]
    algorithms: tuple[str, ...]
    longest: float
    allow_code: bool = False


def scenes_named(names: Sequence[str] | None) -> list[Path]:
    """Return scenes by their names in `configs/hard` or by file; None means all that render something.

    Raises:
        InputError: No scene has that name.
    """
    folder = shipped("configs") / "hard"
    hard = {path.stem: path for path in sorted(folder.glob("*.yaml"))}
    if names is None:
        return [path for name, path in hard.items() if not name.startswith(_OF_THE_PLANT)]
    unknown = [name for name in names if name not in hard and not Path(name).is_file()]
    if unknown:
        raise InputError(f"--scenes: {unknown[0]!r} is no file, and none of: {', '.join(hard)}")
    return [hard.get(name, Path(name)) for name in names]


def label_of(algorithm: str) -> str:
    """Return the name of an algorithm in results: of one's own the file without its folder, and the class."""
    return Path(algorithm).name if is_own(algorithm) else algorithm


def is_own(algorithm: str) -> bool:
    """Whether an algorithm is one's own, named as `FILE.py:Class`."""
    return _MARK in algorithm


def entry_of(reference: str, path: Path, allow_code: bool) -> ComponentSpec:
    """Return the algorithm of one's own that `FILE.py:Class` names, for a scene.

    Args:
        reference: File and class.
        path: Path of the scene, which supplies the keys that the algorithm knows.
        allow_code: Whether the file may run.

    Raises:
        InputError: It may not, or is no algorithm.
    """
    file, _, name = reference.partition(":")
    own = Path(file).resolve()
    text, source = read_regular(path, MAX_BYTES).decode("utf-8"), str(own.with_name(path.name))
    algorithm = f"passivity={{algorithm: {own.name}:{name}}}"
    return scene_from_text(text, source, [algorithm], allow_code=allow_code).axes[0].passivity


def scene_under(path: Path, algorithm: str, *, allow_code: bool = False) -> Scene:
    """Return a scene of one axis under an algorithm that takes from the plant what it cannot do without.

    Raises:
        InputError: The scene has groups or several axes, or own code may not run.
        ParameterError: The algorithm refuses the scene.
    """
    scene = load_scene(path, allow_code=allow_code)
    require_single_axes(scene, "arena")
    if len(scene.axes) != 1:
        raise InputError(f"{path}: has {len(scene.axes)} axes, expected one; make a scene of each")
    if is_own(algorithm):
        own = entry_of(algorithm, path, allow_code)
        scene = replace(scene, axes=(replace(scene.axes[0], passivity=own),))
        algorithm = own.name
    return replace(scene, axes=(able_under(scene.axes[0], algorithm, scene).axis,))


def with_loop(scene: Scene, rate: float, delay: int) -> Scene:
    """Return a scene at another rate [Hz] and delay; torques act at their SYNC, as in a loop without a bus."""
    scene = at_rate(scene, rate)
    timing = {"torque_window": 0.0, "sync_jitter": 0.0}
    bus = scene.bus.model_copy(update={"rpdo": "synchronous" if delay else "event"})
    axes = tuple(replace(a, loop=a.loop.model_copy(update={"delay": bus.delay, **timing})) for a in scene.axes)
    return replace(scene, bus=bus, axes=axes)


def group_figures(group: CaseGroup, known: Iterable[tuple[int, str]] = ()) -> list[CaseFigures]:
    """Return the figures of every case of a group.

    Args:
        group: The cases.
        known: (delay, label of the algorithm) of those that are left out.
    """
    left = set(known)
    asked = [(d, name) for d in group.delays for name in group.algorithms if (d, label_of(name)) not in left]
    if not asked:
        return []
    plain = load_scene(group.path, allow_code=group.allow_code)
    cycles = cycles_of(at_rate(plain, group.rate), min(group.longest, plain.run.duration or group.longest))
    reference = _reference_of(at_rate(plain, group.rate), cycles)
    found = []
    for delay, name in asked:
        case = {"scene": group.path.stem, "rate": group.rate, "delay": delay, "algorithm": label_of(name)}
        make = partial(scene_under, group.path, name, allow_code=group.allow_code)
        try:
            scene = with_loop(make(), group.rate, delay)
            found.append(case | _figures_of(scene, cycles, reference))
        except ParameterError as error:
            found.append(case | {"status": "refused", "remark": str(error).splitlines()[0]})
    return found


def _reference_of(scene: Scene, cycles: int) -> ContinuousReference | None:
    """Return the continuous run of a scene; None where there is none."""
    [axis] = scene.axes
    plant, user, effects, seed = plant_parts(axis)
    try:
        return continuous_reference(environment_of(axis), plant, user, effects, scene.bus.sample_time_ns, cycles, seed)
    except InputError:
        return None


def _figures_of(scene: Scene, cycles: int, reference: ContinuousReference | None) -> CaseFigures:
    case = loop_case(scene.axes[0], scene)
    run = render(case, cycles, None if reference is None else Recorder.around(reference.position))
    return {"status": run.ended or "completed", **_of_run(run, scene, reference)}


def _of_run(run: LoopRun, scene: Scene, reference: ContinuousReference | None) -> CaseFigures:
    """Return the figures of a run, to four digits."""
    environment, sample_time = environment_of(scene.axes[0]), scene.bus.sample_time
    found = figures(environment, run, reference, sample_time)
    stiffness = getattr(environment, "stiffness", None)
    hardness = rate_hardness(run, environment, sample_time)
    error, travel = part(found, "position_error", "rms"), None if reference is None else reference.travel
    share = part(found, "stiffness_rendered", "share")
    values: dict[str, float | None] = {
        "energy_given_out": energy_given_out(run),
        "energy_beyond_device": energy_beyond_device(run, scene.axes[0].loop.device_damping or 0.0, sample_time),
        "position_error": error / travel if error is not None and travel else None,
        "force_variation": part(found, "force_variation", "ratio"),
        "stiffness_error": None if share is None else abs(share - 1.0),
        "rate_hardness": hardness / stiffness if hardness is not None and stiffness else None,
        "limit_cycle": found["limit_cycle"],
        "drag": drag(run),
    }
    certificate = {"certificate": run.summary.certificate.name.lower()}
    return certificate | {name: None if value is None else rounded(value) for name, value in values.items()}


def part(found: Mapping[str, Any], group: str, name: str) -> float | None:
    """Return one figure of a group; None where the group could not be measured."""
    return None if found[group] is None else found[group][name]


def rounded(value: float) -> float:
    """Return a value to four digits."""
    return float(f"{value:.4g}")
