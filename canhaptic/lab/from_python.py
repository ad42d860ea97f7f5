"""Studies of a scene as Python calls: each takes a scene file, a mapping or a loaded scene, as `simulate` does.

A text means what it means on the command line: `"guarded,unprotected"`, `"1e2:1e6:log:40"`, `"10 s"`, `"1 kHz"`.

found = canhaptic.sweep("demo", {"environment.stiffness": [100, 1000, 10000]}, duration=2.0)
print(found["handle.least_interaction"])     # [J], one value per scene
"""

from collections.abc import Callable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any
from warnings import catch_warnings

from canhaptic.cli.options import read
from canhaptic.errors import InputError, OverrideWarning
from canhaptic.lab.batch import Engine
from canhaptic.lab.studies.compare import Case, Comparison
from canhaptic.lab.studies.compare import compare as compare_algorithms
from canhaptic.quantities import OLD_FIGURES
from canhaptic.scene.models import Scene
from canhaptic.simulation import load_any

if TYPE_CHECKING:
    from canhaptic.lab.studies.vary import Column

_SceneLike = str | PathLike[str] | Mapping[str, object] | Scene
_Changes = Mapping[str, object]
_Plain = Mapping[str, Any]


def compare(
    scene: _SceneLike,
    algorithms: Sequence[object] | str | _Changes | None = None,
    changes: _Changes | None = None,
    *,
    duration: float | str | None = None,
    rate: float | str | None = None,
    over_can: bool = False,
    engine: Engine = "python",
    repeats: int = 5,
    progress: Callable[[int], None] | None = None,
    allow_code: bool = False,
) -> Comparison:
    """Return the results of every algorithm on every axis or group of a scene.

    Args:
        scene: A scene file, a mapping with its keys, or a loaded scene; with simulated drives.
        algorithms: Names of algorithms, as a list or separated by commas, or classes and functions of your own, which
            the result names as they are; all that have a name by default. A mapping is taken as `changes`.
        changes: Values of the scene to replace, as for `simulate`.
        duration: Duration [s]; by default the scene's.
        rate: Rate that replaces the scene's [Hz], possibly beyond its bus; for single axes, not over CAN.
        over_can: Whether the whole CAN path is used instead of a loop without a bus.
        engine: Engine without a bus: "python" gives the bits of the path over CAN, "numba" differs by rounding and
            saves time on stiff plants and long runs, "auto" takes it where it is worthwhile.
        repeats: Interleaved timings of a step of a single axis, of which the minimum counts; 0 for none.
        progress: Called with the number of cycles done so far, of all runs together.
        allow_code: Whether program files that the scene names may run.

    Raises:
        InputError: Nothing is simulated, an unknown algorithm, or a rate over CAN.

    Examples:
        >>> canhaptic.compare("demo", ["unprotected", "guarded"]).result["rows"]  # doctest: +SKIP
    """
    if isinstance(algorithms, Mapping):
        changes = {**algorithms, **(changes or {})}
        algorithms = None
    asked: list[Any] | None = read("names", algorithms, "algorithms")
    options: _Plain = {
        "duration": read("seconds", duration, "duration"), "rate": read("rate", rate, "rate"), "over_can": over_can,
        "engine": engine, "repeats": repeats, "progress": progress,
    }  # fmt: skip
    loaded = load_any(scene, changes or {}, allow_code)
    every: list[str | Case] = []
    for own in asked or ():
        if isinstance(own, str):
            every.append(own)
            continue
        name, laid = _in_place_of_the_algorithm(own)
        with catch_warnings(action="ignore", category=OverrideWarning):  # it has parameters of its own
            every.append(Case(load_any(scene, {**(changes or {}), **laid}, allow_code), name, own.__name__))
    return compare_algorithms(loaded, every, **options)


def _in_place_of_the_algorithm(own: object) -> tuple[str, _Changes]:
    """Return the name that a scene has for a class or function of the user's own, and the changes that choose it.

    Raises:
        InputError: It is no algorithm.
    """
    from canhaptic.scene.given import section_of

    try:
        section = section_of(own, "passivity algorithm")
        return str(section["algorithm"]), {f"passivity.{key}": value for key, value in section.items()}
    except (KeyError, TypeError) as error:
        text = f"got {own!r}, expected the name of an algorithm, or a class or a function that is one"
        raise InputError(f"algorithms: {text} ({error})") from error


def sweep(
    scene: _SceneLike,
    vary: Mapping[str, object] | Sequence[str] | str,
    out: str | PathLike[str] | None = None,
    *,
    changes: _Changes | None = None,
    allow_code: bool = False,
    **options: Any,
) -> "Mapping[str, Column]":
    """Return the varied keys and every figure of many scenes, by name, one value per scene.

    Figures are named `AXIS.FIGURE` as in `canhaptic sweep --json`; NaN where a scene failed. `pandas.DataFrame` takes
    the result as it is.

    Args:
        scene: A scene file, a mapping with its keys, or a loaded scene; with simulated drives.
        vary: Values of each key by its path: a number in SI, a text as after `--vary KEY=` ("1e2:1e6:log:40",
            "100 N/m,1 kN/m"), or a list or array of numbers and texts. Or one or several texts as for `--vary`.
        out: Folder that keeps the sweep, for `canhaptic sweep --map` or for `resume=True`; None: it is not kept.
        changes: Values of the scene to replace, as for `simulate`.
        allow_code: Whether program files that the scene names may run.
        options: As for the command: controllers, duration, cycles, metrics, engine, chunk, beyond_bus,
            resume, force.

    Raises:
        InputError: Bad input, an unknown option, or a folder with a sweep.

    Examples:
        >>> canhaptic.sweep("demo", {"environment.damping": [0, 5, 10]}, duration=2.0)  # doctest: +SKIP
    """
    from canhaptic.lab.studies.store import SweepTable
    from canhaptic.lab.studies.sweep import OPTIONS
    from canhaptic.lab.studies.sweep import sweep as run_sweep
    from canhaptic.lab.studies.vary import listed

    loaded = load_any(scene, changes or {}, allow_code)
    if isinstance(vary, Mapping):
        varied: list[Any] = [listed(key, values) for key, values in vary.items()]
    else:
        varied = [vary] if isinstance(vary, str) else list(vary)
    if unknown := options.keys() - OPTIONS.keys():
        raise InputError(f"sweep: got {min(unknown)}, expected options among {', '.join(OPTIONS)}")
    options = {name: read(OPTIONS[name], value, name) for name, value in options.items()}
    if own := [one for one in options.get("controllers") or () if not isinstance(one, str)]:
        raise InputError(f"controllers: got {own[0]!r}, expected names; give it as changes={{'passivity': ...}}")
    with TemporaryDirectory(prefix="canhaptic-sweep-") as folder:
        path = Path(folder) / "sweep" if out is None else Path(out)
        run_sweep(loaded, varied, path, allow_code=allow_code, **options)
        with SweepTable(path) as table:
            found = table.points.columns(0, len(table))
            for axis in table.axes:
                of_axis = {metric: table.figure(axis, metric) for metric in table.metrics}
                of_axis |= {old: of_axis[new] for new, old in OLD_FIGURES.items() if new in of_axis}
                found |= {f"{axis}.{metric}": values for metric, values in of_axis.items()}
    return found


def check(scene: _SceneLike, changes: _Changes | None = None, *, allow_code: bool = False) -> _Plain:
    """Return what `canhaptic check --json` prints: verdict, bus budget, fitness of each drive, stability limits.

    Args:
        scene: A scene file, a mapping with its keys, or a loaded scene.
        changes: Values of the scene to replace, as for `simulate`.
        allow_code: Whether program files that the scene names may run.

    Raises:
        SceneError: The scene is wrong; lists every fault.

    Examples:
        >>> canhaptic.check("demo")["verdict"]  # doctest: +SKIP
    """
    from canhaptic.cli.check import checked

    return checked(load_any(scene, changes or {}, allow_code))


def design(
    scene: _SceneLike,
    changes: _Changes | None = None,
    *,
    margin: float | None = None,
    tolerance: float | None = None,
    allow_code: bool = False,
) -> _Plain:
    """Return the stiffest wall that a rig renders, or the lightest mass of its admittance displays, as plain values.

    Args:
        scene: A scene file, a mapping with its keys, or a loaded scene.
        changes: Values of the scene to replace, as for `simulate`.
        margin: Relative reserve by which stiffness and damping could both be larger and still pass; by default 0.2.
        tolerance: Largest relative difference of a rendering from the requested one; by default 0.05.
        allow_code: Whether program files that the scene names may run.

    Raises:
        InputError: The scene cannot be designed for, or a margin or tolerance is out of range.
        CheckFailedError: Not even the softest wall passes.

    Examples:
        >>> canhaptic.design("demo")["stiffness"]  # doctest: +SKIP
    """
    from canhaptic.lab.studies.design.search import design as design_scene

    options = _given(margin=margin, tolerance=tolerance)
    return design_scene(load_any(scene, changes or {}, allow_code), **options)


def accuracy(
    scene: _SceneLike,
    changes: _Changes | None = None,
    *,
    axis: str | None = None,
    tolerance: float | str | None = None,
    duration: float | str | None = None,
    budget: float | str | None = None,
    allow_code: bool = False,
) -> _Plain:
    """Return what accuracy costs in time, for the simulated plant and for the loop, as plain values.

    Args:
        scene: A scene file, a mapping with its keys, or a loaded scene.
        changes: Values of the scene to replace, as for `simulate`.
        axis: Name of an axis or a group; the first by default.
        tolerance: Largest error of the position [m or rad]; by default a tenth of an encoder count.
        duration: Length of the comparison [s]; by default until the second contact.
        budget: Time for timings [s]; 0 for none, None for the default of the command.
        allow_code: Whether program files that the scene names may run.

    Raises:
        InputError: A scene or an axis that cannot be used.

    Examples:
        >>> canhaptic.accuracy("demo", budget=0.0)["advice"]  # doctest: +SKIP
    """
    from canhaptic.lab.studies.accuracy.study import study_accuracy

    options = _given(
        tolerance=read("length", tolerance, "tolerance"),
        duration=read("seconds", duration, "duration"),
        budget=read("budget", budget, "budget"),
    )
    return study_accuracy(load_any(scene, changes or {}, allow_code), axis, **options)


def touch(
    scene: _SceneLike,
    changes: _Changes | None = None,
    *,
    axis: str | None = None,
    port: int = 0,
    pace: str = "even",
    open_browser: bool = False,
    allow_code: bool = False,
) -> int:
    """Serve the page of `canhaptic touch`, and print its address, until Ctrl-C; return the status of the command.

    The hand is simulated in another process, which imports the classes and functions that are given: define them in a
    file, and call this under `if __name__ == "__main__":`.

    Args:
        scene: A scene file or a loaded scene.
        changes: Values of the scene to replace, as for `simulate`.
        axis: Name of the axis to touch; the first by default.
        port: Port on this computer; 0: any free one.
        pace: "even": late cycles are caught up; "real": they are skipped, as on a rig.
        open_browser: Whether to open the page in a browser.
        allow_code: Whether program files that the scene names may run.

    Raises:
        InputError: The scene cannot be touched, Bokeh is not installed, the port is taken, a notebook calls this,
            something given cannot be imported, or the other process called this.

    Examples:
        >>> canhaptic.touch("demo", {"environment": MyWall(stiffness=300.0)})  # doctest: +SKIP
    """
    from argparse import Namespace
    from asyncio import _get_running_loop
    from multiprocessing import current_process

    from canhaptic.registry import load
    from canhaptic.scene.given import parcel

    if _get_running_loop() is not None:
        raise InputError("touch: a notebook runs a loop of its own; write a script that calls this, and start it")
    if getattr(current_process(), "_inheriting", False):  # as multiprocessing asks itself
        raise InputError("touch: another process imports this script; call touch under `if __name__ == '__main__':`")
    if pace not in ("even", "real"):
        raise InputError(f"pace: got {pace!r}, expected 'even' or 'real'")
    loaded = load_any(scene, changes or {}, allow_code)
    if not loaded.text:
        raise InputError(f"{loaded.source}: touch needs a scene file; write the mapping into one")
    parcel(loaded.overrides, "the process of touch")
    serve = load({"touch": "canhaptic.lab.commands.touch:serve"}, "touch", "command")
    return int(serve(loaded, Namespace(axis=axis, port=port, pace=pace, open=open_browser)))


def _given(**options: float | None) -> dict[str, Any]:
    """Return the options that are not left to their defaults."""
    return {name: value for name, value in options.items() if value is not None}
