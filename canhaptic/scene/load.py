"""Reading of a scene file into a `Scene`: parse, override, convert, validate, complete, cross-check.

Every fault is noted with its line; all of them are raised together, before anything is built.

For a simulation, undeclared properties of the loop are derived. Timing follows from bus and motor, and is never better
than the bit rate of the bus allows: an event RPDO acts when it has arrived, even where the simulated bus does not model
transmission time. The upper bounds of damping and dry friction, which the hand-force certificate needs, follow from the
simulated plant. With real drives nothing is derived: `canhaptic commission` measures these values, the scene declares
them, and no real drive runs before.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from pydantic import ValidationError

from canhaptic.canopen.objects import SYNC_FRAME_COB_ID
from canhaptic.control.passivity import ALGORITHMS, LoopProperties
from canhaptic.drive.can.bus_budget import torque_latency, worst_frame
from canhaptic.drive.can.pdo_map import choose_map
from canhaptic.errors import CanHapticError, InputError, SceneConflictError, SceneError
from canhaptic.files import read_regular, scene_file
from canhaptic.registry import load
from canhaptic.scene.buses import BusParameters, can_bus
from canhaptic.scene.components import CodeUse, ComponentSpec, SceneContext
from canhaptic.scene.cross_checks import cross_check
from canhaptic.scene.document import Diagnostics, MarkedMapping, SourceLocation, mark_plain, parse_yaml
from canhaptic.scene.layout import SECTIONS, laid_out, no_environment
from canhaptic.scene.models import DISPLAY_LOOP_KEYS, FAR, AxisScene, Scene, rests_on_hand_force, scene_adapter
from canhaptic.sim.plant import AccuracyParameters, substeps_for

if TYPE_CHECKING:
    from canhaptic.sim.bus.faulty_bus import BusEffects

MAX_BYTES: Final = 1_000_000
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
        if scene.far is not None:
            name = scene.far.axis
            axes = tuple(replace(of, guard=FAR) if of.parameters.name == name else of for of in scene.axes)
            scene = replace(scene, axes=axes)
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


_GUESSES: Final = {"sync_jitter": 0.05, "torque_window": 100e-6, "current_lag": 500e-6}
"""Values assumed for an undeclared real drive (RPDO transmission is added); no real drive runs on them."""
_NEVER_ZERO: Final = ("torque_window", "current_lag")
"""Keys for which 0 does not count as declared on a real drive: no frame shows how late a torque acts."""
_MOST_JITTER: Final = 0.5
"""Lateness, as a fraction of the sample time, from which a SYNC counts as skipped."""


_DRIFT_STEP: Final = 2e-6
"""Time by which the clock of an EtherCAT drive is shifted at most in one frame [s]."""


def _undeclared(loop: LoopProperties, *, is_real: bool = False) -> list[str]:
    """Return the undeclared timing keys of an axis; with a real drive also lags that are declared as 0."""
    never_zero = _NEVER_ZERO if is_real else ()
    return [key for key in _GUESSES if getattr(loop, key) is None or (key in never_zero and not getattr(loop, key))]


def with_loops(scene: Scene) -> Scene:
    """Return the scene with the undeclared loop properties of its axes; those of real drives are guesses."""
    effects = {name: scene.effects_on(name) for name, _ in scene.buses}
    jitters = {name: _jitter(effects[name], bus) for name, bus in scene.buses}
    if scene.cable_effects is not None and scene.cable_effects.drift:
        jitters[scene.bus_name] = abs(scene.cable_effects.drift) + _DRIFT_STEP / scene.bus.sample_time
    windows = {name: _window(effects[name], bus, scene.axes_on(name)) for name, bus in scene.buses}
    axes, needed = [], list[str]()
    for axis in scene.axes:
        passivity, window = scene.port_of(axis).passivity, windows.get(axis.bus, 0.0)  # an unknown bus was noted before
        needed += [f"{axis.parameters.name}.passivity.{key}" for key in _needed(passivity, axis.loop)]
        found = {**_GUESSES, "torque_window": _GUESSES["torque_window"] + window}
        bounds, ends = dict[str, float](), dict[str, float]()
        if scene.simulation is not None:
            from canhaptic.scene.far_side import device_bounds, lag_of, least_lateness

            if scene.simulated:
                jitter = jitters.get(axis.bus, 0.0)
                found = {"sync_jitter": jitter, "torque_window": window, "current_lag": lag_of(axis)}
                ends = least_lateness(axis, dict(scene.buses).get(axis.bus), effects.get(axis.bus))
            bounds = device_bounds(axis, scene.mechanisms) if rests_on_hand_force(passivity) else {}
        missing = {key: found[key] for key in _undeclared(axis.loop, is_real=not scene.simulated)}
        missing |= {f"{key}_least": least for key, least in ends.items() if least and key in missing}
        missing |= {key: bound for key, bound in bounds.items() if getattr(axis.loop, key) is None}
        axes.append(replace(axis, loop=axis.loop.model_copy(update=missing)) if missing else axis)
    return replace(scene, axes=tuple(axes), undeclared=tuple(needed))


def _needed(passivity: ComponentSpec, loop: LoopProperties) -> list[str]:
    """Return the undeclared keys of `passivity` on which the guarantee of a real axis rests.

    They include the bound of dry friction, for which there is no guess.
    """
    known = passivity.parameters
    rests_on = _GUESSES if hasattr(known, "hand_force") else DISPLAY_LOOP_KEYS if hasattr(known, "loop_gain") else ()
    is_open = loop.device_friction_bound is None and rests_on_hand_force(passivity)
    timing = [key for key in _undeclared(loop, is_real=True) if key in rests_on]
    return timing + (["device_friction_bound"] if is_open else [])


def _late(effects: "BusEffects", cob_id: int | None) -> float:
    """Return the largest delay of a frame to the drive relative to another [s]; `cob_id` None: any frame."""
    if not effects.suffers("to_drive") or (cob_id and effects.ids is not None and cob_id not in effects.ids):
        return 0.0
    late = effects.jitter + (effects.delay if effects.during else 0.0)
    return late + (effects.reorder_delay if effects.reorder else 0.0)


def _jitter(effects: "BusEffects | None", bus: BusParameters) -> float:
    """Return the largest deviation of a hold from the sample time due to a late SYNC, as a fraction of it."""
    if effects is None:
        return 0.0
    late = _late(effects, SYNC_FRAME_COB_ID)
    if effects.wire_time:
        late += worst_frame() / can_bus(bus).bitrate  # one that had just begun
    return min(_MOST_JITTER, late / bus.sample_time)


def _window(effects: "BusEffects | None", bus: BusParameters, axes: Sequence[AxisScene]) -> float:
    """Return the latest time after its SYNC at which a torque acts [s]."""
    if bus.rpdo == "synchronous":
        return 0.0
    window = 0.0
    if effects is not None:
        window = 2.0 * effects.delay + 2.0 * _late(effects, None)
        window += effects.jitter if effects.suffers("to_master") else 0.0
    given = [axis.parameters for axis in axes]
    try:
        maps = [choose_map(axis.dictionary(), axis) for axis in given]
    except (CanHapticError, OSError):
        return window  # noted with the dictionary
    return window + torque_latency(can_bus(bus), maps)


def for_program(scene: Scene, guard: str) -> Scene:
    """Return the scene with axes that apply the torques requested by a program.

    The declarations of an algorithm `guarded` are kept; of any other algorithm only those of the loop.

    Args:
        scene: Scene as loaded.
        guard: "certificates" or "none".

    Raises:
        InputError: An axis is in a group, or is an admittance display.
    """
    if scene.far is not None:
        text = (
            f"{scene.source}: far: {scene.far.axis}: a far side has this axis, and no program may request its torques"
        )
        raise InputError(f"{text}; take `far` out of the scene, or run it with `canhaptic run`")
    for port in scene.ports:
        if port.section or port.causality.holds:
            text = (
                f"{scene.source}: {port.name}: is no torque axis by itself; a program requests torques of single axes"
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
    return replace(axis, environment=no_environment(), passivity=passivity, guard=guard)


def says_none(scene: Scene) -> bool:
    """Return whether a scene itself requests torques without a guard."""
    unprotected = any(axis.passivity.name == "unprotected" for axis in scene.axes)
    return scene.run.guard == "none" or (scene.run.guard is None and unprotected)
