"""One axis of a scene: its own keys laid over the shared sections, each part validated by the model that owns it."""

from typing import Any, Final, get_args

from canhaptic.control.environments import ENVIRONMENTS
from canhaptic.control.passivity import ALGORITHMS
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.drive.axis_parameters import AxisParameters, BusParameters
from canhaptic.drive.profile.quirks import quirks_of
from canhaptic.scene.buses import BUS_KEY
from canhaptic.scene.diagnostics import Diagnostics
from canhaptic.scene.document import MarkedMapping
from canhaptic.scene.eds_path import find_dictionary
from canhaptic.scene.groups import GroupEntry, membership
from canhaptic.scene.models import AxisScene, AxisSimulation, ComponentSpec
from canhaptic.scene.profiles import PROFILE_KEY, with_profile
from canhaptic.scene.section import read_list, read_mapping, read_section, read_type
from canhaptic.scene.simulated_defaults import mirror_quirks
from canhaptic.sim.drive.drive_parameters import SimulatedDriveParameters
from canhaptic.sim.plant.effects import EFFECTS
from canhaptic.sim.plant.plant import PlantParameters
from canhaptic.sim.plant.user import UserParameters
from canhaptic.units import Motion, Parameters

LOOP_KEYS: Final = ("moving_mass", "device_damping", "device_damping_bound", "delay", "sample_time")
"""Keys of `passivity` that describe the loop and not the algorithm; the last two follow from the bus."""
OWN_SECTIONS: Final = ("environment", "passivity")
"""Shared sections of which an axis may have its own."""
SCALING_KEYS: Final = ("counts_per_unit", "rated_torque", "direction")
"""Keys of an axis that its simulated drive takes over unless `simulation.drive` has its own."""
SIMULATION_PARTS: Final = ("drive", "plant", "user", "effects")
"""Parts of `simulation` that `simulation.axes.NAME` may have its own of."""


def read_axis(
    section: MarkedMapping,
    shared: MarkedMapping,
    bus: BusParameters | None,
    seed: int,
    faults: Diagnostics,
    group: GroupEntry | None = None,
    moves_mechanism: bool = False,
) -> AxisScene | None:
    """Returns one axis; None when it has faults, which are all noted.

    Args:
        section: Its entry of `axes`.
        shared: The whole scene, for the sections that all axes share.
        bus: The bus, None when it has faults.
        seed: Of everything random in its simulation.
        faults: Receives one line per fault.
        group: That renders on it; None when it renders for itself.
        moves_mechanism: Whether its simulated motor is one of a mechanism.
    """
    section = with_profile(section, faults)
    motion = _motion(section)
    own = find_dictionary(section.without(*OWN_SECTIONS, BUS_KEY), faults)
    parameters = read_section(AxisParameters, own, faults, motion, also=(*OWN_SECTIONS, BUS_KEY, PROFILE_KEY))
    environment, passivity, of_loop = _rendered(section, shared, group, faults, motion)
    loop = _loop(of_loop or MarkedMapping(section.mark), parameters, bus, faults, motion)
    simulation_section = _simulation_of(shared, str(section.get("name")), faults)
    simulation, drive = None, None
    if simulation_section is not None and moves_mechanism:
        _refuse_own_plant(shared, str(section.get("name")), faults)
        drive = read_section(SimulatedDriveParameters, _drive(simulation_section, own, faults), faults, motion)
    elif simulation_section is not None:
        simulation = _simulation(simulation_section, own, seed, faults, motion)
    if parameters is None or environment is None or passivity is None or loop is None:
        return None
    if simulation_section is not None and simulation is None and drive is None:
        return None
    name = "" if group is None else group.name
    return AxisScene(parameters, environment, passivity, loop, simulation, group=name, simulated_drive=drive)


def _rendered(
    section: MarkedMapping, shared: MarkedMapping, group: GroupEntry | None, faults: Diagnostics, motion: Motion | None
) -> tuple[ComponentSpec | None, ComponentSpec | None, MarkedMapping | None]:
    """Returns environment and algorithm of an axis, and the section that describes its loop."""
    if group is not None:
        return membership(group), membership(group), _loop_in_group(section, group, faults)
    environment = overlay(shared, section, "environment", "type", faults)
    passivity = overlay(shared, section, "passivity", "algorithm", faults)
    return _environment(environment, faults, motion), _passivity(passivity, faults, motion), passivity


def _loop_in_group(section: MarkedMapping, group: GroupEntry, faults: Diagnostics) -> MarkedMapping | None:
    """Returns what a scene says of the loop of an axis in a group: its own `passivity` over that of the group."""
    if section.get("environment") is not None:
        faults.add(section.keys_at["environment"], f"group {group.name!r} renders on this axis; leave it out")
    of_group = group.section.get("passivity")
    loop = of_group if isinstance(of_group, MarkedMapping) else None
    if section.get("passivity") is None:
        return loop
    own = read_mapping(section["passivity"], section.value_at("passivity"), faults, ", ".join(LOOP_KEYS))
    if own is None:
        return loop
    for key in own.keys() - set(LOOP_KEYS):
        faults.add(
            own.keys_at[key],
            f"group {group.name!r} renders on this axis; give it in the group, and here only {', '.join(LOOP_KEYS)}",
        )
    return own if loop is None else own.over(loop)


def _refuse_own_plant(shared: MarkedMapping, name: str, faults: Diagnostics) -> None:
    """Notes every part of `simulation.axes.NAME` that the mechanism has instead."""
    axes = shared["simulation"].get("axes")
    own = axes.get(name) if isinstance(axes, MarkedMapping) else None
    if isinstance(own, MarkedMapping):
        for key in own.keys() & {"plant", "user", "effects"}:
            faults.add(
                own.keys_at[key], f"{name!r} moves a mechanism, which has masses and hand of its own; leave it out"
            )


def overlay(
    shared: MarkedMapping, own: MarkedMapping, name: str, selector: str, faults: Diagnostics
) -> MarkedMapping | None:
    """Returns a section of an axis: its own keys over the shared ones, unless it names another type.

    None, with a fault, when there is no such section.
    """
    before, result = len(faults), None
    for owner in (shared, own):
        value = owner.get(name)
        if value is None:
            continue
        section = read_mapping(value, owner.value_at(name), faults, f"{selector} and its parameters")
        if section is None:
            continue
        if result is None or section.get(selector, result.get(selector)) != result.get(selector):
            result = section
        else:
            result = section.over(result)
    if result is None and len(faults) == before:
        faults.add(shared.value_at(name), f"missing; give it here or in the axis, with {selector}")
    return result


def _motion(section: MarkedMapping) -> Motion | None:
    field = AxisParameters.model_fields["unit"]
    unit = section.get("unit", None if field.is_required() else field.default)
    return unit if unit in get_args(Motion) else None


def _environment(section: MarkedMapping | None, faults: Diagnostics, motion: Motion | None) -> ComponentSpec | None:
    found = None if section is None else read_type(section, "type", "environment", ENVIRONMENTS, faults)
    if section is None or found is None:
        return None
    name, model = found
    parameters = read_section(model, section.without("type"), faults, motion, also=("type",))
    return None if parameters is None else ComponentSpec(name, parameters)


def _passivity(section: MarkedMapping | None, faults: Diagnostics, motion: Motion | None) -> ComponentSpec | None:
    found = None if section is None else read_type(section, "algorithm", "passivity algorithm", ALGORITHMS, faults)
    if section is None or found is None:
        return None
    name, algorithm = found
    model: type[Parameters] = algorithm.parameters_type
    own = section.without("algorithm", *(key for key in LOOP_KEYS if key not in model.model_fields))
    parameters = read_section(model, own, faults, motion, also=("algorithm", *LOOP_KEYS))
    return None if parameters is None else ComponentSpec(name, parameters)


def _loop(
    section: MarkedMapping,
    axis: AxisParameters | None,
    bus: BusParameters | None,
    faults: Diagnostics,
    motion: Motion | None,
) -> LoopProperties | None:
    """Returns what the scene says of the loop around the controller; what it does not say stays unknown."""
    loop = section.only(LOOP_KEYS)
    at = section.mark
    derived: dict[str, Any] = {"sample_time": bus.sample_time_ns * 1e-9 if bus else 1e-3}
    if bus is not None:
        derived["delay"] = bus.delay
    if axis is not None:
        derived["encoder_count"] = 1.0 / abs(axis.counts_per_unit)
        derived["torque_limit"] = axis.torque_limit
        if axis.rated_torque is not None:
            derived["torque_quantum"] = axis.rated_torque * quirks_of(axis.quirks).torque_scale / 1000.0
    for key, value in derived.items():
        if loop.get(key) is None:
            loop.put(key, value, at, at)
    return read_section(LoopProperties, loop, faults, motion)


def _simulation_of(shared: MarkedMapping, name: str, faults: Diagnostics) -> MarkedMapping | None:
    """Returns the parts of `simulation` for one axis, its own laid over the shared; None when nothing is simulated."""
    section = shared.get("simulation")
    if not isinstance(section, MarkedMapping):
        return None  # absent, or a fault noted by the reader of the whole scene
    parts = section.only(SIMULATION_PARTS)
    axes = section.get("axes")
    own = axes.get(name) if isinstance(axes, MarkedMapping) else None
    if own is not None:
        own = read_mapping(own, section["axes"].value_at(name), faults, ", ".join(SIMULATION_PARTS))
    return parts if own is None else _parts_laid_over(own, parts)


def _parts_laid_over(own: MarkedMapping, shared: MarkedMapping) -> MarkedMapping:
    """Returns the shared parts with an axis's own laid over: key by key where both are mappings."""
    result = shared.copy()
    for key, value in own.items():
        below = shared.get(key)
        if isinstance(value, MarkedMapping) and isinstance(below, MarkedMapping):
            value = value.over(below)
        result.put(key, value, own.keys_at[key], own.values_at[key])
    return result


def _simulation(
    section: MarkedMapping, axis: MarkedMapping, seed: int, faults: Diagnostics, motion: Motion | None
) -> AxisSimulation | None:
    before = len(faults)
    drive = read_section(SimulatedDriveParameters, _drive(section, axis, faults), faults, motion)
    plant = read_section(PlantParameters, _part(section, "plant", faults), faults, motion)
    user = None
    if section.get("user") is not None:
        user = read_section(UserParameters, _part(section, "user", faults), faults, motion)
    effects = _effects(section, faults, motion)
    if len(faults) > before or drive is None or plant is None:
        return None
    return AxisSimulation(drive, plant, user, effects, seed)


def _part(section: MarkedMapping, name: str, faults: Diagnostics) -> MarkedMapping:
    absent = MarkedMapping(section.value_at(name))
    if section.get(name) is None:
        return absent
    return read_mapping(section[name], section.value_at(name), faults, "its parameters") or absent


def _drive(section: MarkedMapping, axis: MarkedMapping, faults: Diagnostics) -> MarkedMapping:
    """Returns the simulated drive's parameters; its scaling is the axis's unless it is given one of its own."""
    drive = _part(section, "drive", faults).copy()
    for key in SCALING_KEYS:
        if key not in drive and axis.get(key) is not None:
            drive.put(key, axis[key], axis.keys_at[key], axis.values_at[key])
    mirror_quirks(drive, axis)
    return drive


def _effects(section: MarkedMapping, faults: Diagnostics, motion: Motion | None) -> tuple[ComponentSpec, ...]:
    value = section.get("effects")
    if value is None:
        return ()
    entries = read_list(value, section.value_at("effects"), faults, "effects, each with type")
    effects = []
    for entry, at in entries.items_at() if entries is not None else ():
        effect = read_mapping(entry, at, faults, "type and its parameters")
        found = None if effect is None else read_type(effect, "type", "effect", EFFECTS, faults)
        if effect is not None and found is not None:
            parameters = read_section(found[1], effect.without("type"), faults, motion, also=("type",))
            effects += [ComponentSpec(found[0], parameters)] if parameters is not None else []
    return tuple(effects)
