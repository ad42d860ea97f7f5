"""The simulated side of a scene: its sections in the file, plants, mechanisms, drives, and faults of the bus.

`put_far_side` completes the simulation of an axis. A simulated drive inherits the quirks of its axis, so that a scene
for a real drive shows how that drive will behave; any key of `simulation.drive` wins.

Only a scene with a simulation loads this module.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from math import inf
from typing import TYPE_CHECKING, Any, Final, Literal, TypeVar, cast

from canhaptic.drive.profile.quirks import TWINS
from canhaptic.errors import InputError, ParameterError
from canhaptic.registry import load
from canhaptic.scene.buses import BusParameters, can_bus, kind_of, part
from canhaptic.scene.components import ComponentSpec
from canhaptic.scene.document import Diagnostics, MarkedList, MarkedMapping, SourceLocation
from canhaptic.scene.models import SCALING_KEYS, SIMULATION_PARTS, AxisScene, AxisSimulation, MechanismScene, Scene
from canhaptic.units import Parameters, Unit

if TYPE_CHECKING:
    import can

    from canhaptic.control.axis_meter import Accuracy
    from canhaptic.control.passivity import LoopProperties
    from canhaptic.drive.axis_parameters import AxisParameters
    from canhaptic.sim.bus.faulty_bus import BusEffects, FaultyBus
    from canhaptic.sim.drive import SimulatedDriveParameters
    from canhaptic.sim.drive.profile.servo import Motor
    from canhaptic.sim.plant.effects import Effect
    from canhaptic.sim.plant.mechanism import Mechanism, MechanismMotor, MechanismParameters
    from canhaptic.sim.plant.plant import Plant

_Made = TypeVar("_Made")
_SEEDS_APART: Final = 1_000_003  # from one bus to the next
_ANY: Final = 1e6  # [N or N*m]
_OF_A_WINDING: Final = ("supply", "back_emf", "resistance")
_SIGMAS: Final = 6.0
"""Standard deviations of a noise that no sample is expected to exceed: 2e-9 of the samples do."""
_BOUNDS: Final = ("device_damping_bound", "device_friction_bound")
_NO_LAG: Final = 1.0
"""Lag declared for a torque whose lag has no bound [s]: the largest accepted value, with which nothing is certified."""
_MILLI: Final = 1e-3
_LARGEST_RATIO: Final = 1e9  # anything larger is a fault of the axis, noted there
_CHOICES: Final = {"auto": "canhaptic.lab.studies.accuracy.study:with_chosen_accuracy"}
"""Automatic accuracy -> "module:function" that chooses it, imported only for a scene with `accuracy: {auto: ...}`."""


def build_plant(simulation: AxisSimulation, sample_time_ns: int) -> "Plant":
    """Return the motor and user of one axis, at rest until the first SYNC with the drive enabled.

    Args:
        simulation: Plant, user and effects.
        sample_time_ns: Time between two SYNCs [ns].
    """
    effects = [effect_of(effect) for effect in simulation.effects]
    given = simulation.user, effects, sample_time_ns, simulation.seed, simulation.accuracy
    if simulation.admittance is not None:
        from canhaptic.sim.plant.velocity_drive import VelocityDrivenPlant

        return VelocityDrivenPlant(simulation.plant, simulation.admittance, *given)
    from canhaptic.sim.plant.plant import Plant

    return Plant(simulation.plant, *given)


def effect_of(effect: ComponentSpec) -> "Effect":
    """Return the parameters of a simulated effect, which are also the object that the plant calls."""
    return cast("Effect", effect.parameters)  # every class of EFFECTS is one


def build_mechanism(of: MechanismScene, sample_time_ns: int) -> "Mechanism":
    """Return a simulated mechanism, at rest until the last of its drives is enabled.

    Raises:
        ParameterError: The mechanism cannot reach the pose in its parameters.
    """
    parameters = cast("MechanismParameters", of.mechanism.parameters)  # every class of MECHANISMS is one
    return parameters.build(of.hand, sample_time_ns, of.substeps)


def _shared_motors(mechanisms: Sequence[MechanismScene], sample_time_ns: int) -> "dict[str, MechanismMotor]":
    """Return the motors of simulated mechanisms, by the name of their axis."""
    from canhaptic.sim.plant.mechanism import SharedMechanism

    motors: dict[str, MechanismMotor] = {}
    for of in mechanisms:
        shared = SharedMechanism(build_mechanism(of, sample_time_ns), len(of.axes))
        motors.update(zip(of.axes, shared.motors, strict=True))
    return motors


def with_effects(
    bus: "can.BusABC", scene: Scene, side: Literal["master", "drive"], index: int = 0
) -> "FaultyBus | None":
    """Return a connection with the simulated faults of its bus; None for an ideal bus.

    Args:
        bus: Opened connection.
        scene: Scene of the bus.
        side: Side that owns the connection.
        index: Index of the bus in the scene.
    """
    name, parameters = scene.buses[index]
    if (effects := scene.effects_on(name)) is None or scene.simulation is None:
        return None
    from canhaptic.sim.bus.faulty_bus import FaultyBus

    seed = scene.simulation.seed + _SEEDS_APART * index
    return FaultyBus(bus, effects, bitrate=can_bus(parameters).bitrate, seed=seed, side=side)


def build_far_end(scene: Scene, name: str | None, bus: "can.BusABC | None" = None) -> tuple[Any, Sequence[Any]]:
    """Return the simulated drives of one bus together (`DrivesOnBus`, `Cable`), and each in the order of their axes.

    Args:
        scene: Scene with a `simulation`.
        name: Name of the bus; None for the only one.
        bus: Connection to a CAN bus.

    Raises:
        InputError: The scene has no `simulation`.
        ParameterError: A simulated drive cannot be made.
    """
    if scene.accuracy_tolerance is not None:
        scene = with_accuracy(scene)
    kind = kind_of(dict(scene.buses).get(name or "", scene.bus))
    seed = 0 if scene.simulation is None else scene.simulation.seed
    plans = _drives_of(scene, name, partial(part(kind, "simulated_drive"), bus))
    group, drives = part(kind, "simulated")(bus, plans, scene.bus.sample_time_ns, scene.cable_effects, seed)
    for drive in drives:
        if (connect := getattr(drive.servo.motor, "connect", None)) is not None:
            connect(partial(getattr, drive.servo, "torque"))
    return group, drives


def _drives_of(
    scene: Scene, name: str | None, made: "Callable[[AxisParameters, Motor, SimulatedDriveParameters, int], _Made]"
) -> "list[_Made]":
    """Return what `made` makes of each axis on a bus, its motor, the parameters of its drive and the sample time [ns].

    Raises:
        InputError: The scene has no `simulation`.
    """
    period, drives = scene.bus.sample_time_ns, list["_Made"]()
    motors = _shared_motors(scene.mechanisms, period) if scene.mechanisms else {}
    for axis in (axis for axis in scene.axes if name in (None, axis.bus)):
        of = axis.parameters
        try:
            if axis.simulation is not None:
                drives.append(made(of, build_plant(axis.simulation, period), axis.simulation.drive, period))
            elif axis.simulated_drive is not None:
                drives.append(made(of, motors[of.name], axis.simulated_drive, period))
        except ParameterError as error:
            raise ParameterError(f"{scene.source}: simulation.drive of {axis.parameters.name}: {error}") from error
    if not drives:
        raise InputError(f"{scene.source}: has no `simulation`, so there is no drive to simulate; add one")
    return drives


def with_accuracy(scene: Scene) -> Scene:
    """Return a scene that has `accuracy: {auto: ...}` with the accuracy chosen for its tolerance."""
    chosen: Scene = load(_CHOICES, "auto", "choice of accuracy")(scene)
    return chosen


def device_bounds(axis: AxisScene, mechanisms: Sequence[MechanismScene]) -> dict[str, float]:
    """Return upper bounds of damping and friction of an axis's simulated device; empty where it is not simulated."""
    if axis.simulation is not None:
        effects = [effect.parameters for effect in axis.simulation.effects]
        damping = axis.simulation.plant.damping + sum(map(_damping, effects))
        return dict(zip(_BOUNDS, (damping, sum(map(_friction, effects))), strict=True))
    for of in mechanisms:
        if axis.parameters.name in of.axes:
            return _bounds_of_mechanism(of, of.axes.index(axis.parameters.name))
    return {}


def _damping(effect: Any) -> float:
    """Return the largest damping of an effect on the body at the encoder.

    The bristles of LuGre friction damp too until they slide. A stop and a shaft do not damp the device.
    """
    kind = getattr(effect, "type", "")  # own code has none
    if kind == "viscous_friction":
        return float(effect.damping)
    return float(effect.viscous + effect.bristle_damping) if kind == "lugre_friction" else 0.0


def _friction(effect: Any) -> float:
    """Return the largest force of an effect at any speed: dry friction, cogging."""
    if getattr(effect, "type", "") == "cogging":
        return float(effect.amplitude)
    return float(max(getattr(effect, "static", 0.0), getattr(effect, "kinetic", 0.0)))


def _bounds_of_mechanism(of: MechanismScene, place: int) -> dict[str, float]:
    given: Any = of.mechanism.parameters
    guide = f"_{'xy'[place]}" if of.mechanism.name == "xy_stage" else ""
    friction = getattr(given, f"friction{guide}", None)
    static = 0.0 if friction is None else float(max(friction.static, friction.kinetic))
    return dict(zip(_BOUNDS, (float(getattr(given, f"damping{guide}", 0.0)), static), strict=True))


def lag_of(axis: AxisScene) -> float:
    """Return the largest time constant from commanded to motor torque [s]; `_NO_LAG` if the motor may not follow."""
    effects = _effects(axis.simulation)
    lag = float(getattr(effects.get("current_loop"), "time_constant", 0.0))
    slowest: Callable[..., float] | None = getattr(effects.get("voltage_limit"), "slowest_lag", None)
    if slowest is None:
        return lag
    return min(slowest(lag, axis.parameters.torque_limit or inf, axis.parameters.largest_speed), _NO_LAG)


def least_lateness(axis: AxisScene, bus: "BusParameters | None", effects: "BusEffects | None") -> dict[str, float]:
    """Return the lower ends of `torque_window` and `current_lag` of a simulated axis [s].

    On a bus that delays every frame, the position and the torque that answers it come late one after the other.
    """
    named = _effects(axis.simulation)
    lag = 0.0 if "voltage_limit" in named else float(getattr(named.get("current_loop"), "time_constant", 0.0))
    delay = 0.0
    if effects is not None and bus is not None and bus.rpdo == "event":
        is_even = effects.direction == "both" and effects.ids is None and not effects.during
        delay = effects.delay if is_even else 0.0
    return {"torque_window": 2.0 * delay, "current_lag": lag}


def _twin_of(axis: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keys of the simulated drive that follow from its axis; wrong values of the axis are skipped.

    Args:
        axis: Keys of the axis as written, completed from its profile.
    """
    twin: dict[str, Any] = {}
    names = axis.get("quirks")
    for name in names if isinstance(names, list | tuple) else ():
        for key, value in TWINS.get(str(name), {}).items():
            twin[key] = _joined(twin.get(key), value)
    if axis.get("demand_reported") == "after":
        twin["torque_read_back"] = "after_update"
    if isinstance(axis.get("brake"), Mapping):
        twin["brake"] = axis["brake"]
    ratio = _ratio(axis.get("transmission"))
    if ratio is not None:  # 0x6076 counts the motor's torque
        twin["rated_torque_resolution"] = ratio * twin.get("rated_torque_resolution", _MILLI)
    return twin


def _ratio(written: object) -> float | None:
    """Return a transmission ratio; None without one, or with a wrong one, which is noted as a fault of the axis."""
    try:
        ratio = Unit("1/m", "1").read(written)
    except ValueError:
        return None
    return ratio if isinstance(ratio, int | float) and 0.0 < ratio < _LARGEST_RATIO else None


def _joined(before: object, value: Any) -> object:
    if isinstance(before, list):
        return [*before, *value]
    return {**before, **value} if isinstance(before, dict) else value


def put_far_side(
    axis: MarkedMapping, name: str, simulation: MarkedMapping, moves_mechanism: bool, faults: Diagnostics
) -> None:
    """Set the simulation of an axis: drive, plant, user and effects, or the drive alone if it moves a mechanism."""
    parts, own = simulation.only(SIMULATION_PARTS), _own_parts(name, simulation, faults)
    for key, value in own.items():
        below = parts.get(key)
        if isinstance(value, MarkedMapping) and isinstance(below, MarkedMapping):
            value = value.over(below)
        parts.put(key, value, own.keys_at[key], own.values_at[key])
    drive = _drive(parts, axis["parameters"], faults)
    if moves_mechanism:
        axis.set("simulated_drive", drive)
        for key in own.keys() & {"plant", "user", "effects"}:
            text = f"{name!r} moves a mechanism, which has masses and hand of its own; leave it out"
            faults.add(own.keys_at[key], text)
        return
    for key in ("user", "effects", "admittance"):
        if parts.get(key) is None:
            parts = parts.without(key)
    if parts.get("plant") is None:
        parts.set("plant", MarkedMapping(parts.value_at("plant")))
    parts.set("drive", drive)
    axis.set("simulation", parts.only(SIMULATION_PARTS))


def _own_parts(name: str, simulation: MarkedMapping, faults: Diagnostics) -> MarkedMapping:
    """Return the entry of an axis in `simulation.axes`; an empty mapping without one."""
    axes, own = simulation.get("axes"), None
    if isinstance(axes, MarkedMapping):
        own = faults.section(axes, name, ", ".join(SIMULATION_PARTS))
    return MarkedMapping(simulation.mark) if own is None else own


def _drive(parts: MarkedMapping, axis: MarkedMapping, faults: Diagnostics) -> MarkedMapping:
    """Return the simulated drive's parameters; its scaling is the axis's unless it has its own."""
    written = faults.section(parts, "drive", "its parameters")
    drive = MarkedMapping(parts.value_at("drive")) if written is None else written.copy()
    for key in SCALING_KEYS:
        if key not in drive and axis.get(key) is not None:
            drive.put(key, axis[key], axis.keys_at[key], axis.values_at[key])
    for key, value in _twin_of(axis).items():
        if key not in drive:
            drive.put(key, value, axis.value_at("quirks"), axis.value_at("quirks"))
    _mirror_scales(drive, axis)
    return drive


def _section(owner: MarkedMapping, key: str) -> MarkedMapping:
    """Return a section; an empty one where there is none, or another value."""
    section = owner.get(key)
    return section if isinstance(section, MarkedMapping) else MarkedMapping(owner.mark)


def _mirror_scales(drive: MarkedMapping, axis: MarkedMapping) -> None:
    """Give the simulated drive of an admittance display the scales of its axis, unless it has its own."""
    given, own = _section(axis, "admittance"), drive.get("display", MarkedMapping(drive.mark))
    force = _section(given, "force")
    if "per_count" not in force or not isinstance(own, MarkedMapping):
        return
    at = axis.value_at("admittance")
    scales, named = own.copy(), {f"force_{key}": force.get(key) for key in ("object", "node", "per_count")}
    named["force_offset_counts"] = force.get("offset_counts", 0.0)
    named["velocity_counts"] = given.get("velocity_counts")
    for key, value in named.items():
        if value is not None and key not in scales:
            scales.put(key, value, at, at)
    drive.put("display", scales, at, at)


def loop_of_simulated(axis: AxisScene, simulation: AxisSimulation) -> "LoopProperties":
    """Return the loop properties of an axis with the errors of its simulated encoder and its motor's torque limit."""
    effects, loop = _effects(simulation), axis.loop
    error = 0.5 * _value(effects, "encoder_quantisation", "count")
    error += _SIGMAS * _value(effects, "encoder_noise", "deviation")
    limit, changes = _value(effects, "torque_saturation", "limit", inf), dict[str, float]()
    if error:
        changes["encoder_count"] = loop.encoder_count + 2.0 * error
    if limit < (inf if loop.torque_limit is None else loop.torque_limit):
        changes["torque_limit"] = limit
    return loop.model_copy(update=changes) if changes else loop


def with_torque_errors(accuracy: "Accuracy", axis: AxisScene, simulation: AxisSimulation) -> "Accuracy":
    """Return an accuracy with the errors of a simulated motor's torque."""
    effects = _effects(simulation)
    unasked = _unasked(effects, axis)
    return replace(
        accuracy,
        torque_share=1.0 if "thermal_derating" in effects else _value(effects, "torque_ripple", "amplitude"),
        torque_offset=0.5 * _value(effects, "torque_quantisation", "quantum") + unasked,
        acts_unasked=unasked > 0.0,
        torque_limit=_value(effects, "torque_saturation", "limit", inf),
    )


def _effects(simulation: AxisSimulation | None) -> Mapping[str, Parameters]:
    return {effect.name: effect.parameters for effect in (simulation.effects if simulation is not None else ())}


def _value(effects: Mapping[str, Parameters], name: str, key: str, otherwise: float = 0.0) -> float:
    return float(getattr(effects[name], key)) if name in effects else otherwise


def _unasked(effects: Mapping[str, Parameters], axis: AxisScene) -> float:
    """Return the largest unrequested torque of a motor whose back-EMF can reach its supply; 0 if it cannot."""
    if "voltage_limit" not in effects:
        return 0.0
    supply, constant, resistance = (_value(effects, "voltage_limit", of) for of in _OF_A_WINDING)
    speed, torque = axis.parameters.largest_speed, axis.parameters.torque_limit or _ANY
    if supply > constant * speed + resistance * torque / constant:
        return 0.0
    return constant * (supply + constant * speed) / resistance + torque


def check_plants(scene: Scene, sections: MarkedMapping, faults: Diagnostics) -> None:
    """Build each plant and mechanism once, so that it reports its objections.

    Args:
        scene: Scene with a `simulation`.
        sections: Sections from which it was read.
        faults: Receives the faults.
    """
    for axis in scene.axes:
        if axis.simulation is None or not axis.is_read:
            continue
        try:
            build_plant(axis.simulation, scene.bus.sample_time_ns)
        except ParameterError as error:
            faults.add(_place_in_simulation(axis, sections["simulation"], error.part), str(error))
    if scene.mechanisms:
        _check_mechanisms(scene, sections, faults)


def _place_in_simulation(axis: AxisScene, simulation: MarkedMapping, part: str) -> SourceLocation:
    """Return the location of the part that a plant refuses: an effect of this type, else the plant."""
    for owner in (_section(_section(simulation, "axes"), axis.parameters.name), simulation):
        effects = owner.get("effects")
        if isinstance(effects, MarkedList):
            for effect, at in effects.items_at():
                if isinstance(effect, MarkedMapping) and part == effect.get("type"):
                    return at
    return simulation.value_at("plant")


def _check_mechanisms(scene: Scene, sections: MarkedMapping, faults: Diagnostics) -> None:
    """Note axes that cannot move a mechanism, and what the mechanism refuses, such as a singular initial pose."""
    for of, section in zip(scene.mechanisms, sections["simulation"]["mechanisms"], strict=True):
        (name, model, *_), before, at = of.mechanism, len(faults), section.value_at("axes")
        motion, members = cast("MechanismParameters", model).motion, [scene.axis(axis) for axis in of.axes]
        for axis in members:
            if axis.parameters.unit != motion:
                text = f"got {axis.parameters.name!r} with unit {axis.parameters.unit}, expected unit: {motion}, in"
                faults.add(at, f"{text} which the motors of a {name} move")
        if len({axis.bus for axis in members}) > 1:
            faults.add(at, "got axes of several buses, expected one bus for axes simulated together")
        try:
            if len(faults) == before:
                build_mechanism(of, scene.bus.sample_time_ns)
        except ParameterError as error:
            faults.add(section.mark, str(error))
