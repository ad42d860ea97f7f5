"""Checks that need more than one section of a scene."""

from collections import Counter
from typing import TYPE_CHECKING, cast

from canhaptic.axis_units import effort_unit
from canhaptic.canopen.eds import read_dictionary
from canhaptic.drive.axis_parameters import BusParameters
from canhaptic.drive.can.bus_budget import require_budget, shortest_answer
from canhaptic.drive.can.dictionary_check import check_dictionary
from canhaptic.drive.can.pdo_map import AxisMap, choose_map
from canhaptic.drive.profile.fitness import Verdict, limit_objection
from canhaptic.drive.profile.quirks import quirks_of
from canhaptic.errors import BusBudgetError, DictionaryError, ParameterError
from canhaptic.host.interfaces import interface_faults
from canhaptic.scene.document import Diagnostics, MarkedList, MarkedMapping, SourceLocation
from canhaptic.scene.layout import bus_section
from canhaptic.scene.models import AxisScene, Scene
from canhaptic.scene.parts import build_axis_controller, build_group
from canhaptic.scene.timing import rests_on_hand_force
from canhaptic.units import shown

if TYPE_CHECKING:
    from canhaptic.sim.plant.mechanism import MechanismParameters


def cross_check(scene: Scene, sections: MarkedMapping, faults: Diagnostics, *, beyond_bus: bool = False) -> None:
    """Note errors between sections of a scene that are each valid on their own.

    Args:
        scene: Scene as read.
        sections: Sections from which it was read.
        faults: Receives the faults.
        beyond_bus: Whether a rate that its bus cannot carry is accepted.
    """
    _check_unique(scene, sections["axes"], faults)
    if len(faults):  # what follows takes its time for each axis, and a name or node ID may be that of thousands
        return
    _check_buses(scene, sections, faults)
    _check_somebody_answers(scene, sections, faults)
    _check_effects(scene, sections, faults)
    _check_interfaces(scene, sections, faults)
    _check_loss_limits(scene, sections["axes"], faults)
    _check_demand_reported(scene, sections["axes"], faults)
    _check_hold(scene, sections["axes"], faults)
    maps: dict[str, list[AxisMap | None]] = {bus.name: [] for bus in scene.buses}
    for axis, entry in zip(scene.axes, sections["axes"], strict=True):
        _check_loop(axis, _passivity_section(axis, entry, sections, scene), scene, faults)
        _check_display(axis, entry, scene, faults)
        axis_map = _check_parts(axis, entry, sections, scene, faults)
        maps[axis.bus].append(axis_map)
        if axis_map is not None and not scene.simulated:
            _check_window(axis, axis_map, _passivity_section(axis, entry, sections, scene), scene, faults)
    _check_groups(scene, sections, faults)
    _check_mechanisms(scene, sections, faults)
    for index, bus in enumerate(scene.buses):
        on_bus = maps[bus.name]
        if None not in on_bus and not beyond_bus:
            _check_budget(bus.parameters, [m for m in on_bus if m is not None], bus_section(sections, index), faults)


def _check_unique(scene: Scene, entries: list[MarkedMapping], faults: Diagnostics) -> None:
    """Note names used twice in the rig, and node IDs used twice on one bus."""
    for key in ("name", "node_id"):
        values = [(getattr(a.parameters, key), a.bus if key == "node_id" else "") for a in scene.axes]
        for value, count in Counter(values).items():
            if count == 1:
                continue
            places = [entry.value_at(key) for entry, seen in zip(entries, values, strict=True) if seen == value]
            for place in places[1:count]:
                faults.add(place, f"got {value[0]!r}, which is the {key} of another axis already ({places[0].where})")
    for axis, entry in zip(scene.axes, entries, strict=True):
        if axis.parameters.node_id == scene.bus.master_id:
            at = entry.value_at("node_id")
            faults.add(at, f"got {axis.parameters.node_id}, which is the node ID of the master (bus.master_id)")


def _check_interfaces(scene: Scene, sections: MarkedMapping, faults: Diagnostics) -> None:
    for index, (_, bus) in enumerate(scene.buses):
        for key, message in interface_faults(bus):
            faults.add(bus_section(sections, index).value_at(key), message)


def _check_loss_limits(scene: Scene, entries: list[MarkedMapping], faults: Diagnostics) -> None:
    for axis, entry in zip(scene.axes, entries, strict=True):
        if axis.parameters.energy_loss_limit == "none" and not scene.simulated:
            message = (
                "got 'none', but the drives may be real; expected a limit, or no entry for 10 mJ: a run that "
                "keeps giving out energy must end"
            )
            faults.add(entry.value_at("energy_loss_limit"), message)


def _check_demand_reported(scene: Scene, entries: list[MarkedMapping], faults: Diagnostics) -> None:
    """Note axes whose TPDO shows a torque that no RPDO has carried yet: with `event` the RPDO follows the SYNC.

    Also axes without read-back of a lost command, where a certificate is to survive lost RPDOs.
    """
    for axis, entry in zip(scene.axes, entries, strict=True):
        if axis.parameters.demand_reported == "after" and scene.bus_of(axis).rpdo == "event":
            faults.add(
                entry.value_at("demand_reported"),
                "got 'after', but with bus.rpdo: event no torque changes at SYNC: the TPDO has the torque of the hold "
                "that ended; leave it out, or set rpdo: synchronous",
            )
        losses = getattr(scene.passivity_of(axis).parameters, "max_consecutive_losses", 0)
        if axis.parameters.demand_reported == "after" and losses:
            faults.add(
                entry.value_at("demand_reported"),
                f"got 'after' with max_consecutive_losses {losses}: a lost TPDO would have shown the torque of the "
                "next hold, and where an RPDO is lost as well nothing shows it; set max_consecutive_losses: 0",
            )


def _check_hold(scene: Scene, entries: list[MarkedMapping], faults: Diagnostics) -> None:
    """Note axes whose torque acts in a hold other than the bus says."""
    late: dict[str, int] = {}  # of the first axis of each group
    for axis, entry in zip(scene.axes, entries, strict=True):
        quirks, rpdo = quirks_of(axis.parameters.quirks), scene.bus_of(axis).rpdo
        if quirks.acts_at_once and rpdo != "event":
            text = (
                f"got 'acts_at_once' with bus.rpdo: {rpdo}: every hold would be booked with the torque of its neighbour"
            )
            faults.add(entry.value_at("quirks"), f"{text}; set rpdo: event")
        if quirks.syncs_late and rpdo == "event":
            text = "got 'acts_a_sync_late' with bus.rpdo: event, where no torque waits for a SYNC"
            faults.add(entry.value_at("quirks"), f"{text}; set rpdo: synchronous, or leave it out")
        if axis.parameters.check_hold is not None and (why := _why_unchecked(scene, axis)):
            faults.add(entry.value_at("check_hold"), f"got a check at each start {why}")
        if (dither := axis.parameters.hold_dither) is not None:
            if axis.group or axis.guard or axis.parameters.admittance or axis.passivity.name != "guarded":
                text = "got a sequence where `guarded` does not render on this axis alone"
                faults.add(entry.value_at("hold_dither"), f"{text}; leave it out, or set algorithm: guarded")
            elif 2.0 * dither < axis.loop.torque_quantum:
                text = f"got {dither:.3g}, expected at least half a step of the torque, {axis.loop.torque_quantum:.3g}"
                faults.add(entry.value_at("hold_dither"), text)
        if axis.group and quirks.syncs_late != late.setdefault(axis.group, quirks.syncs_late):
            text = f"the axes of group {axis.group!r} act in different holds"
            faults.add(entry.value_at("quirks"), f"{text}; expected acts_a_sync_late on all of them, or on none")


def _why_unchecked(scene: Scene, axis: AxisScene) -> str:
    """Return why no test at a start can find the hold of an axis, with the remedy; empty where one can."""
    if axis.parameters.admittance is not None:
        return "of a drive that holds a velocity; leave it out"
    if axis.loop.moving_mass is None:
        return "without moving_mass, which keeps its motion small; declare it (canhaptic commission measures it)"
    if axis.parameters.torque_verified == "no" and not scene.simulated:
        return "of a torque whose scale is not verified; run canhaptic commission first"
    return "of axes that a simulated mechanism couples; leave it out" if scene.mechanisms else ""


def _check_buses(scene: Scene, sections: MarkedMapping, faults: Diagnostics) -> None:
    """Note buses of one channel, buses that no axis is on, and virtual ones among others."""
    names = [bus.name for bus in scene.buses]
    places = [(bus.parameters.interface, str(bus.parameters.channel)) for bus in scene.buses]
    is_virtual = [bus.parameters.interface == "virtual" for bus in scene.buses]
    for index, (name, bus) in enumerate(scene.buses):
        section, before = bus_section(sections, index), places.index(places[index])
        if before < index and (bus.channel is not None or not is_virtual[index]):
            faults.add(
                section.value_at("channel"),
                f"interface {bus.interface!r}, channel {shown(bus.channel)} is bus {names[before]!r} already; "
                "give each bus its own channel",
            )
        if not scene.axes_on(name):
            text = f"no axis is on bus {name!r}; name it in `bus` of an axis, or leave it out"
            faults.add(section.value_at("name"), text)
    if len(set(is_virtual)) > 1:
        faults.add(
            bus_section(sections, is_virtual.index(True)).value_at("interface"),
            "got 'virtual' together with a bus of another interface; either all buses are inside this process, or none",
        )


def _check_somebody_answers(scene: Scene, sections: MarkedMapping, faults: Diagnostics) -> None:
    for index, (_, bus) in enumerate(scene.buses):
        if bus.interface != "virtual" or scene.simulation is not None or bus.channel is not None:
            continue
        faults.add(
            bus_section(sections, index).value_at("interface"),
            "interface 'virtual' reaches no drive outside this process, and the scene has no `simulation`; "
            "add one, or name the interface and channel of the real bus (interface: socketcan, channel: can0)",
        )


def _check_effects(scene: Scene, sections: MarkedMapping, faults: Diagnostics) -> None:
    names = [bus.name for bus in scene.buses]
    unknown = [name for name in (scene.bus_effects and scene.bus_effects.buses) or () if name not in names]
    if unknown:
        known = ", ".join(name for name in names if name) or "none, the scene's bus has no name"
        at = sections["simulation"]["bus"].value_at("buses")
        faults.add(at, f"got {', '.join(map(repr, unknown))}, which names no bus of the scene; expected: {known}")


def _check_loop(axis: AxisScene, passivity: MarkedMapping, scene: Scene, faults: Diagnostics) -> None:
    """Compare a scene's declarations about the loop with the properties of its bus."""
    late = quirks_of(axis.parameters.quirks).syncs_late
    if axis.loop.delay < scene.bus.delay + late:
        with_quirk = f", and its quirks by {late} more" if late else ""
        faults.add(
            passivity.value_at("delay"),
            f"got {axis.loop.delay}, but bus.rpdo: {scene.bus.rpdo} delays the torque by {scene.bus.delay} hold"
            f"{with_quirk}; leave it out, or set rpdo: event",
        )
    friction, bound = axis.loop.device_friction or 0.0, axis.loop.device_friction_bound
    if bound is not None and friction > bound and rests_on_hand_force(scene, axis):
        unit = effort_unit(axis.parameters.unit)
        faults.add(
            passivity.value_at("device_friction"),
            f"got {friction:g} {unit} at least, but device_friction_bound says {bound:g} {unit} at most; measure both "
            "(canhaptic commission)",
        )
    cogging, stiffness = axis.loop.device_cogging_bound, axis.loop.presliding_stiffness
    if (cogging is None) is not (stiffness is None) or (cogging or 0.0) > (bound or 0.0):
        faults.add(
            passivity.value_at("presliding_stiffness" if cogging is None else "device_cogging_bound"),
            "friction brakes only where device_friction_bound, device_cogging_bound within it and presliding_stiffness "
            "are all declared; declare them, or leave the last two out",
        )
    if abs(axis.loop.sample_time - scene.bus.sample_time) > 1e-9:
        faults.add(
            passivity.value_at("sample_time"),
            f"got {axis.loop.sample_time:g} s, but bus.rate of {scene.bus.rate:g} Hz makes it "
            f"{scene.bus.sample_time:g} s; leave it out",
        )


def _check_window(
    axis: AxisScene, axis_map: AxisMap, passivity: MarkedMapping, scene: Scene, faults: Diagnostics
) -> None:
    """Note a torque window shorter than its bus allows, as carried over from a simulation in lock-step."""
    bus, window = scene.bus_of(axis), axis.loop.torque_window
    least = shortest_answer(bus.bitrate, axis_map)
    if bus.rpdo == "event" and window is not None and window < least:
        faults.add(
            passivity.value_at("torque_window"),
            f"got {window:g} s, but SYNC, TPDO and RPDO take {least:.3g} s at least at {bus.bitrate:g} bit/s; measure "
            "it (canhaptic commission), or set rpdo: synchronous",
        )


def _check_budget(bus: BusParameters, maps: list[AxisMap], section: MarkedMapping, faults: Diagnostics) -> None:
    try:
        require_budget(bus, maps)
    except BusBudgetError as error:
        faults.add(section.value_at("rate"), str(error))


def _check_parts(
    axis: AxisScene, entry: MarkedMapping, sections: MarkedMapping, scene: Scene, faults: Diagnostics
) -> AxisMap | None:
    """Build the parts once so that each reports its objections; return the PDO map that the dictionary permits."""
    try:
        if not axis.group and axis.is_read:
            build_axis_controller(axis)
    except ParameterError as error:
        faults.add(_passivity_section(axis, entry, sections, scene).mark, str(error))
    if axis.simulation is not None and axis.is_read:
        from canhaptic.scene.far_side import build_plant

        try:
            build_plant(axis.simulation, scene.bus.sample_time_ns)
        except ParameterError as error:
            faults.add(_place_in_simulation(axis, sections["simulation"], error.part), str(error))
    return _check_dictionary(axis, entry, scene, faults)


def _check_display(axis: AxisScene, entry: MarkedMapping, scene: Scene, faults: Diagnostics) -> None:
    if axis.parameters.admittance is None and (axis.simulation is None or axis.simulation.admittance is None):
        return
    from canhaptic.scene.displays import check_display

    check_display(axis, entry, scene, faults)


def _place_in_simulation(axis: AxisScene, simulation: MarkedMapping, part: str) -> SourceLocation:
    """Place in the scene of the part that a plant refuses: an effect of this type, or the plant."""
    axes = simulation.get("axes")
    own = axes.get(axis.parameters.name) if isinstance(axes, MarkedMapping) else None
    for owner in (own, simulation):
        effects = owner.get("effects") if isinstance(owner, MarkedMapping) else None
        if isinstance(effects, MarkedList):
            for effect, at in effects.items_at():
                if isinstance(effect, MarkedMapping) and part == effect.get("type"):
                    return at
    return simulation.value_at("plant")


def _check_dictionary(axis: AxisScene, entry: MarkedMapping, scene: Scene, faults: Diagnostics) -> AxisMap | None:
    """Note every reason why the drive's dictionary does not serve; return the PDO map when it does."""
    try:
        dictionary = read_dictionary(axis.parameters.eds, axis.parameters.node_id)
    except DictionaryError as error:
        faults.add(entry.value_at("eds"), str(error))
        return None
    refusals = [
        f for f in check_dictionary(dictionary, axis.parameters, scene.bus_of(axis)) if f.verdict is Verdict.REFUSED
    ]
    for finding in refusals:
        faults.add(entry.value_at("eds"), f"{axis.parameters.eds}: {finding.item}: {finding.text}")
    if not scene.simulated and (text := limit_objection(dictionary, axis.parameters)):
        faults.add(entry.value_at("admittance"), f"{axis.parameters.eds}: 0x6072 max torque: {text}")
    return None if refusals else choose_map(dictionary, axis.parameters)


def _check_groups(scene: Scene, sections: MarkedMapping, faults: Diagnostics) -> None:
    """Note incompatible network, kinematics and passivity of a group."""
    for group, section in zip(scene.groups, sections.get("groups") or (), strict=True):
        try:
            build_group(scene, group)
        except ParameterError as error:
            faults.add(section.mark, str(error))


def _check_mechanisms(scene: Scene, sections: MarkedMapping, faults: Diagnostics) -> None:
    """Note axes that cannot move a mechanism, and its own objections, such as a singular initial pose."""
    if not scene.mechanisms:
        return
    from canhaptic.scene.far_side import build_mechanism

    for of, section in zip(scene.mechanisms, sections["simulation"]["mechanisms"], strict=True):
        (name, model, _), before, at = of.mechanism, len(faults), section.value_at("axes")
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


def _passivity_section(axis: AxisScene, entry: MarkedMapping, sections: MarkedMapping, scene: Scene) -> MarkedMapping:
    """Return where a scene speaks of the loop of an axis: the axis's own section, the shared one, or the group's."""
    owners = [entry, sections]
    if axis.group:
        place = [group.name for group in scene.groups].index(axis.group)
        owners = [entry, sections["groups"][place]]
    owner = next(owner for owner in owners if isinstance(owner.get("passivity"), MarkedMapping))
    section: MarkedMapping = owner["passivity"]
    return section
