"""A scene file to a `Scene`: read, overridden, converted, validated, cross-checked.

Every fault found on the way is noted with its line; all of them are raised together, before anything is built.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from canhaptic.control.passivity import ALGORITHMS
from canhaptic.errors import InputError, SceneConflictError, SceneError
from canhaptic.input_file import read_regular, scene_file
from canhaptic.registry import load
from canhaptic.scene.components import CodeUse, ComponentSpec, SceneContext
from canhaptic.scene.cross_checks import cross_check
from canhaptic.scene.document import Diagnostics, MarkedMapping, SourceLocation, mark_plain, parse_yaml
from canhaptic.scene.layout import SECTIONS, laid_out
from canhaptic.scene.models import AxisScene, AxisSimulation, Scene, scene_adapter
from canhaptic.scene.timing import with_device_bounds, with_timing
from canhaptic.sim.plant.accuracy_parameters import AccuracyParameters, substeps_for

MAX_BYTES: Final = 1_000_000
_PROGRAM: Final = {"program": "canhaptic.control.passivity.asked_torque:Program"}
_OF_GUARDS: Final[dict[str, tuple[str, dict[str, Any]]]] = {
    "certificates": ("guarded", {"hand_force": None}),
    "none": ("unprotected", {}),
}
"""Guard of a program -> algorithm in its place, and its settings where the scene has another one."""


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
        leave_code: Whether such files, and plug-ins, stay unread, to inspect the rest of a scene from
            which nothing is built.
        beyond_bus: Whether a rate that its bus cannot carry is accepted: for studies only, no run could keep it.

    Raises:
        SceneError: The file cannot be read, several scenes have the name, or anything in it is wrong; lists every fault
            with its line.
    """
    place = scene_file(Path(path))
    return _read(_text(place), str(place), overrides, "left" if leave_code else _use(allow_code), beyond_bus)


def scene_from_text(text: str, source: str, overrides: Sequence[str] = (), *, allow_code: bool = False) -> Scene:
    """Validated scene of YAML text, such as the copy in an energy log.

    Args:
        text: The scene.
        source: File of the text: named in faults, and the base of relative paths.
        overrides: As for `load_scene`.
        allow_code: As for `load_scene`.

    Raises:
        SceneError: Anything in it is wrong; lists every fault with its line.
    """
    return _read(text, source, overrides, _use(allow_code))


def _use(allow_code: bool) -> CodeUse:
    return "run" if allow_code else "refused"


def scene_from_mapping(
    values: Mapping[str, Any], source: str = "scene", overrides: Sequence[str] = (), *, allow_code: bool = False
) -> Scene:
    """Return the validated scene of plain Python values with the keys of a scene file.

    Raises:
        SceneError: Anything in it is wrong; lists every fault.
    """
    return _read(values, source, overrides, _use(allow_code))


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
    """Return the scene; None when it has faults, which are all noted."""
    try:
        scene = scene_adapter().validate_python(laid, context=context)
        if context.has_code:
            scene = replace(scene, own_code=context.code.hashes, unread=tuple(context.code.left))
        scene = with_device_bounds(with_timing(_completed(scene)))
        return scene if scene.run.guard is None else for_program(scene, scene.run.guard)
    except ValidationError as error:
        from canhaptic.scene.explain import note_errors

        note_errors(Scene, laid, error, faults)
    except RecursionError:
        faults.add(sections.mark, "nested too deeply")
    return None


def _accuracy_of(axis: AxisScene, simulation: AxisSimulation, scene: Scene) -> AccuracyParameters:
    """Return the accuracy that the scene gives; substeps that it does not give follow from its effects."""
    if "substeps" in scene.accuracy.model_fields_set:
        return scene.accuracy
    torque = axis.parameters.torque_limit or axis.parameters.rated_torque or 0.0
    named = [getattr(effect.parameters, "fastest", None) for effect in simulation.effects]
    rates = [fastest(simulation.plant.mass, torque) for fastest in named if fastest is not None]
    return scene.accuracy.model_copy(update={"substeps": substeps_for(rates, scene.bus.sample_time)})


def _completed(scene: Scene) -> Scene:
    """Scene whose simulated plants have the common seed and accuracy."""
    whole = scene.simulation
    if whole is None:
        return scene
    axes = (
        axis if axis.simulation is None else replace(axis, simulation=replace(
            axis.simulation, seed=whole.seed + index, accuracy=_accuracy_of(axis, axis.simulation, scene)
        ))
        for index, axis in enumerate(scene.axes)
    )  # fmt: skip
    mechanisms = (replace(of, substeps=scene.accuracy.substeps) for of in scene.mechanisms)
    return replace(scene, axes=tuple(axes), mechanisms=tuple(mechanisms))


def for_program(scene: Scene, guard: str) -> Scene:
    """Scene whose axes apply the torques requested by a program.

    If the algorithm is `guarded` its declarations are kept; for any other only the loop's.

    Args:
        scene: Scene as loaded.
        guard: "certificates" or "none".

    Raises:
        InputError: Axes render together, or an axis takes force and gives velocity.
    """
    for axis in scene.axes:
        what = "renders in a group" if axis.group else "is an admittance display" if axis.parameters.admittance else ""
        if what:
            text = (
                f"{scene.source}: {axis.parameters.name}: {what}; a program requests torques of axes that stand alone"
            )
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
