"""Reading of a scene file into a `Scene`: parse, override, convert, validate, cross-check.

Every fault is noted with its line; all of them are raised together, before anything is built.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from canhaptic.control.passivity import ALGORITHMS
from canhaptic.errors import InputError, SceneConflictError, SceneError
from canhaptic.files import read_regular, scene_file
from canhaptic.registry import load
from canhaptic.scene.components import CodeUse, ComponentSpec, SceneContext
from canhaptic.scene.cross_checks import cross_check
from canhaptic.scene.document import Diagnostics, MarkedMapping, SourceLocation, mark_plain, parse_yaml
from canhaptic.scene.layout import SECTIONS, laid_out
from canhaptic.scene.models import AxisScene, Scene, scene_adapter
from canhaptic.scene.timing import with_loops
from canhaptic.sim.plant import AccuracyParameters, substeps_for

MAX_BYTES: Final = 1_000_000
_PROGRAM: Final = {"program": "canhaptic.control.passivity.asked_torque:Program"}
_OF_GUARDS: Final[dict[str, tuple[str, dict[str, Any]]]] = {
    "certificates": ("guarded", {"hand_force": None}),
    "none": ("unprotected", {}),
}
"""Guard of a program -> algorithm that implements it, and its settings if the scene names another algorithm."""


def load_scene(
    path: str | Path,
    overrides: Sequence[str] = (),
    *,
    allow_code: bool = False,
    leave_code: bool = False,
    beyond_bus: bool = False,
) -> Scene:
    """Return the validated scene of a YAML file.

    Args:
        path: The scene file, or the name of a shipped scene (`demo`, `hard/stiff_wall`).
        overrides: Replace values of the file, each `path.to.key=VALUE` with a YAML value (`axes.0.node_id=5`).
        allow_code: Whether program files that the scene names (`type: my_wall.py:MyWall`) may run.
        leave_code: Whether such files, and plug-ins, stay unread; the scene can then be inspected, but not built.
        beyond_bus: Whether a rate that the bus cannot carry is accepted, for studies without a bus.

    Raises:
        SceneError: The file cannot be read, several scenes have the name, or anything in it is wrong; lists every fault
            with its line.
    """
    place = scene_file(Path(path))
    use: CodeUse = "left" if leave_code else "run" if allow_code else "refused"
    return _read(_text(place), str(place), overrides, use, beyond_bus)


def scene_from_text(text: str, source: str, overrides: Sequence[str] = (), *, allow_code: bool = False) -> Scene:
    """Return the validated scene of YAML text, such as the copy in an energy log.

    Args:
        text: The scene.
        source: File of the text, named in faults; relative paths start from its folder.
        overrides: As for `load_scene`.
        allow_code: As for `load_scene`.

    Raises:
        SceneError: Anything in it is wrong; lists every fault with its line.
    """
    return _read(text, source, overrides, "run" if allow_code else "refused")


def scene_from_mapping(
    values: Mapping[str, Any], source: str = "scene", overrides: Sequence[str] = (), *, allow_code: bool = False
) -> Scene:
    """Return the validated scene of plain Python values with the keys of a scene file.

    Raises:
        SceneError: Anything in it is wrong; lists every fault.
    """
    return _read(values, source, overrides, "run" if allow_code else "refused")


def _text(path: Path) -> str:
    try:
        content = read_regular(path, MAX_BYTES)
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line, byte = content[: error.start].count(b"\n") + 1, content[error.start]
        raise SceneError([f"{path}:{line}: not UTF-8 text (byte 0x{byte:02x}); save it as UTF-8"]) from error
    except OSError as error:
        text = f"{path}: cannot be read ({error.strerror}); give the path of a scene file (YAML)"
        raise SceneError([text]) from error


def _read(
    written: str | Mapping[str, Any], source: str, overrides: Sequence[str], use: CodeUse, beyond_bus: bool = False
) -> Scene:
    faults, text = Diagnostics(), written if isinstance(written, str) else ""
    document = parse_yaml(text, source, faults) if isinstance(written, str) else mark_plain(written, source)
    if not isinstance(document, MarkedMapping):
        faults.raise_if_any()
    top = SourceLocation(source, int(bool(text)), int(bool(text)), ())
    if document is None:
        faults.add(top, f"empty, expected a mapping with {', '.join(SECTIONS)}")
        raise faults.error()
    sections = faults.mapping(document, top, ", ".join(SECTIONS))
    if sections is None:
        raise faults.error()
    if overrides:
        from canhaptic.scene.overrides import apply_overrides

        apply_overrides(sections, overrides, faults)
    laid = laid_out(sections, source, text, overrides, faults)
    context = SceneContext(folder=Path(source).parent, use=use, simulated=laid["simulation"] is not None)
    scene = _validated(sections, laid, faults, context)
    if scene is None or len(faults):
        raise faults.error()
    cross_check(scene, sections, faults, beyond_bus=beyond_bus)
    faults.raise_if_any(SceneConflictError)
    return scene


def _validated(
    sections: MarkedMapping, laid: MarkedMapping, faults: Diagnostics, context: SceneContext
) -> Scene | None:
    """Return the scene; None if it has faults, which are noted."""
    try:
        scene = scene_adapter().validate_python(laid, context=context)
        if context.has_code:
            scene = replace(scene, own_code=context.code.hashes, unread=tuple(context.code.left))
        if (whole := scene.simulation) is not None:
            given, time = scene.accuracy, scene.bus.sample_time
            axes = tuple(_completed(axis, given, whole.seed + n, time) for n, axis in enumerate(scene.axes))
            mechanisms = tuple(replace(of, substeps=given.substeps) for of in scene.mechanisms)
            scene = replace(scene, axes=axes, mechanisms=mechanisms)
        scene = with_loops(scene)
        return scene if scene.run.guard is None else for_program(scene, scene.run.guard)
    except ValidationError as error:
        from canhaptic.scene.explain import note_errors

        note_errors(Scene, laid, error, faults)
    except RecursionError:
        faults.add(sections.mark, "nested too deeply")
    return None


def _completed(axis: AxisScene, given: AccuracyParameters, seed: int, sample_time: float) -> AxisScene:
    """Return an axis whose simulated plant has a seed and the given accuracy.

    Substeps that are not given follow from its effects.
    """
    if (simulation := axis.simulation) is None:
        return axis
    if "substeps" not in given.model_fields_set:
        torque = axis.parameters.torque_limit or axis.parameters.rated_torque or 0.0
        named = [getattr(effect.parameters, "fastest", None) for effect in simulation.effects]
        rates = [fastest(simulation.plant.mass, torque) for fastest in named if fastest is not None]
        given = given.model_copy(update={"substeps": substeps_for(rates, sample_time)})
    return replace(axis, simulation=replace(simulation, seed=seed, accuracy=given))


def for_program(scene: Scene, guard: str) -> Scene:
    """Return the scene with axes that apply the torques requested by a program.

    The declarations of an algorithm `guarded` are kept; of any other algorithm only those of the loop.

    Args:
        scene: Scene as loaded.
        guard: "certificates" or "none".

    Raises:
        InputError: An axis is in a group, or is an admittance display.
    """
    for axis in scene.axes:
        what = "renders in a group" if axis.group else "is an admittance display" if axis.parameters.admittance else ""
        if what:
            text = f"{scene.source}: {axis.parameters.name}: {what}; a program requests torques of single axes"
            raise InputError(f"{text}: take the axis out of the group, or render an environment with `canhaptic run`")
    axes = tuple(_for_program(axis, guard) for axis in scene.axes)
    if scene.run.guard is not None:
        if scene.run.guard != guard:
            raise InputError(f"{scene.source}: was loaded with guard: {scene.run.guard}; load it with guard: {guard}")
        return replace(scene, axes=axes)
    run, said = scene.run.model_copy(update={"guard": guard}), f"guard={guard}"
    return replace(scene, axes=axes, run=run, overrides=(*scene.overrides, said))


def _for_program(axis: AxisScene, guard: str) -> AxisScene:
    (name, known), passivity = _OF_GUARDS[guard], axis.passivity
    if passivity.name != name:
        passivity = ComponentSpec(name, load(ALGORITHMS, name, "passivity algorithm").parameters_type(**known))
    environment = ComponentSpec("program", load(_PROGRAM, "program", "environment")())
    return replace(axis, environment=environment, passivity=passivity, guard=guard)


def says_none(scene: Scene) -> bool:
    """Return whether a scene itself requests torques without a guard."""
    unprotected = any(axis.passivity.name == "unprotected" for axis in scene.axes)
    return scene.run.guard == "none" or (scene.run.guard is None and unprotected)
