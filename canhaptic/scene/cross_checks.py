"""Checks of a scene that need more than one of its sections."""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from canhaptic.axis_units import effort_unit, stiffness_unit
from canhaptic.canopen.eds import DriveDictionary
from canhaptic.drive.axis_parameters import AxisParameters, CanBusParameters
from canhaptic.drive.can.bus_budget import require_budget, shortest_answer
from canhaptic.drive.can.pdo_map import AxisMap, check_dictionary, choose_map
from canhaptic.drive.profile.fitness import Finding, Verdict, limit_objection, profile_findings
from canhaptic.drive.profile.quirks import quirks_of
from canhaptic.errors import BusBudgetError, DictionaryError, ParameterError
from canhaptic.host.interfaces import interface_faults
from canhaptic.scene.buses import DICTIONARIES, PLACES, BusParameters, kind_of, part
from canhaptic.scene.components import ComponentSpec
from canhaptic.scene.document import Diagnostics, MarkedMapping, SourceLocation
from canhaptic.scene.layout import bus_section
from canhaptic.scene.models import FAR, AxisScene, Scene, rests_on_hand_force
from canhaptic.scene.parts import build_far_port, controller_of
from canhaptic.units import shown


def cross_check(scene: Scene, sections: MarkedMapping, faults: Diagnostics, *, beyond_bus: bool = False) -> None:
    """Note contradictions between sections of a scene that are each valid on their own.

    Args:
        scene: Validated scene.
        sections: Sections of the file, which locate the faults.
        faults: Receives the faults.
        beyond_bus: Whether a rate that the bus cannot carry is accepted.
    """
    _check_unique(scene, sections["axes"], faults)
    if len(faults):  # what follows takes its time for each axis, and a name or node ID may be that of thousands
        return
    _check_buses(scene, sections, faults)
    maps: dict[str, list[AxisMap | None]] = {bus.name: [] for bus in scene.buses}
    of_groups = dict(zip((group.name for group in scene.groups), sections.get("groups") or (), strict=True))
    marks = {name: section.mark for name, section in of_groups.items()}
    for axis, entry in zip(scene.axes, sections["axes"], strict=True):
        given = (owner.get("passivity") for owner in (entry, of_groups.get(axis.group, sections)))
        loop = next(section for section in given if isinstance(section, MarkedMapping))
        port = scene.port_of(axis)
        known = scene.bus_of(axis), port.passivity, not scene.simulated, bool(scene.mechanisms)
        least = dict[str, float]()
        if scene.simulated:
            from canhaptic.scene.far_side import least_lateness

            least = least_lateness(axis, scene.bus_of(axis), scene.effects_on(axis.bus))
        maps[axis.bus].append(_check_axis(_Checked(axis, port.axes[0], entry, loop, *known, least), faults))
        marks[axis.parameters.name] = loop.mark
    _check_controllers(scene, marks, faults)
    _check_far(scene, sections, faults)
    if scene.simulation is not None:
        from canhaptic.scene.far_side import check_plants

        check_plants(scene, sections, faults)
    for index, (name, bus) in enumerate(scene.buses):
        if None not in maps[name] and not beyond_bus and isinstance(bus, CanBusParameters):
            try:
                require_budget(bus, [axis_map for axis_map in maps[name] if axis_map is not None])
            except BusBudgetError as error:
                faults.add(bus_section(sections, index).value_at("rate"), str(error))


class _Checked(NamedTuple):
    """One axis, with the other parts of the scene that must fit it."""

    axis: AxisScene
    first: AxisScene  # of its port
    entry: MarkedMapping  # its section as written
    loop: MarkedMapping  # section `passivity` with its loop: its own, the group's or the shared one
    bus: BusParameters
    passivity: ComponentSpec  # algorithm that renders on it
    is_real: bool
    is_coupled: bool  # whether the scene has simulated mechanisms
    least: dict[str, float]  # how late its torques act at least, as simulated [s]


def _check_axis(of: _Checked, faults: Diagnostics) -> AxisMap | None:
    """Note the faults of an axis; return the PDO map of its drive, if its dictionary is fit."""
    for key, text in _faults_of_axis(of):
        faults.add(of.entry.value_at(key) if key else of.entry.mark, text)
    axis_map = _check_dictionary(of, faults)
    for key, text in _faults_of_loop(of, axis_map):
        faults.add(of.loop.value_at(key), text)
    return axis_map


def _check_unique(scene: Scene, entries: Sequence[MarkedMapping], faults: Diagnostics) -> None:
    """Note names used twice in the rig, and node IDs or positions used twice on one bus."""
    kinds = {bus.name: kind_of(bus.parameters) for bus in scene.buses}
    master_id = getattr(scene.buses[-1].parameters, "master_id", None)
    for is_place in (False, True):
        first: dict[tuple[object, str], SourceLocation] = {}
        for axis, entry in zip(scene.axes, entries, strict=True):
            key = PLACES[kinds.get(axis.bus, "can")] if is_place else "name"
            value, at = getattr(axis.parameters, key), entry.value_at(key)
            seen = value, axis.bus if is_place else ""
            if seen in first:
                faults.add(at, f"got {value!r}, which is the {key} of another axis already ({first[seen].where})")
            first.setdefault(seen, at)
            if key == "node_id" and value == master_id:
                faults.add(at, f"got {value}, which is the node ID of the master (bus.master_id)")


def _faults_of_axis(of: _Checked) -> Iterator[tuple[str, str]]:
    """Yield the keys of an axis that do not fit its bus or its algorithm, each with the text of the fault."""
    axis, given, rpdo = of.axis, of.axis.parameters, of.bus.rpdo
    if given.energy_loss_limit == "none" and of.is_real:
        text = "got 'none', but the drives may be real; expected a limit, or no entry for 10 mJ"
        yield "energy_loss_limit", f"{text}: a run that keeps giving out energy must end"
    if given.demand_reported == "after" and rpdo == "event":  # where the RPDO follows the SYNC
        text = "got 'after', but with bus.rpdo: event no torque changes at SYNC: the TPDO has the torque of the hold"
        yield "demand_reported", f"{text} that ended; leave it out, or set rpdo: synchronous"
    losses = getattr(of.passivity.parameters, "max_consecutive_losses", 0)
    if given.demand_reported == "after" and losses:
        text = f"got 'after' with max_consecutive_losses {losses}: a lost TPDO would have shown the torque of the next"
        text = f"{text} hold, and where an RPDO is lost as well nothing shows it"
        yield "demand_reported", f"{text}; set max_consecutive_losses: 0"
    yield from _faults_of_hold(of)
    if given.admittance is not None or getattr(axis.simulation, "admittance", None) is not None:
        from canhaptic.scene.displays import display_faults

        yield from display_faults(axis, of.bus, is_real=of.is_real)


def _faults_of_hold(of: _Checked) -> Iterator[tuple[str, str]]:
    """Yield the keys that contradict the bus on the hold in which the torque acts, or the algorithm on its check."""
    axis, quirks, rpdo = of.axis, quirks_of(of.axis.parameters.quirks), of.bus.rpdo
    if quirks.acts_at_once and rpdo != "event":
        text = f"got 'acts_at_once' with bus.rpdo: {rpdo}: every hold would be booked with the torque of its neighbour"
        yield "quirks", f"{text}; set rpdo: event"
    if quirks.syncs_late and rpdo == "event":
        text = "got 'acts_a_sync_late' with bus.rpdo: event, where no torque waits for a SYNC"
        yield "quirks", f"{text}; set rpdo: synchronous, or leave it out"
    if axis.parameters.check_hold is not None and (why := _why_unchecked(of)):
        yield "check_hold", f"got a check at each start {why}"
    if (dither := axis.parameters.hold_dither) is not None:
        if axis.guard or axis.parameters.admittance or axis.passivity.name != "guarded":
            text = "got a sequence where `guarded` does not render on this axis alone"
            yield "hold_dither", f"{text}; leave it out, or set algorithm: guarded"
        elif 2.0 * dither < axis.loop.torque_quantum:
            text = f"got {dither:.3g}, expected at least half a step of the torque, {axis.loop.torque_quantum:.3g}"
            yield "hold_dither", text
    if quirks.syncs_late != quirks_of(of.first.parameters.quirks).syncs_late:
        text = f"the axes of group {axis.group!r} act in different holds"
        yield "quirks", f"{text}; expected acts_a_sync_late on all of them, or on none"


def _why_unchecked(of: _Checked) -> str:
    """Return why no test at a start can find the hold of an axis, with the remedy; empty if one can."""
    axis = of.axis
    if holds := axis.parameters.causality.holds:
        return f"of a drive that holds {holds}; leave it out"
    if axis.loop.moving_mass is None:
        return "without moving_mass, which keeps its motion small; declare it (canhaptic commission measures it)"
    if axis.parameters.torque_verified == "no" and of.is_real:
        return "of a torque whose scale is not verified; run canhaptic commission first"
    return "of axes that a simulated mechanism couples; leave it out" if of.is_coupled else ""


def _check_buses(scene: Scene, sections: MarkedMapping, faults: Diagnostics) -> None:
    """Note buses that share a channel, have no axis or reach no drive, mixed kinds of bus, and faults of no bus."""
    names = [bus.name for bus in scene.buses]
    places = [(bus.parameters.interface, str(bus.parameters.channel)) for bus in scene.buses]
    is_virtual = [interface == "virtual" for interface, _ in places]
    for index, (name, bus) in enumerate(scene.buses):
        section, before = bus_section(sections, index), places.index(places[index])
        for key, message in interface_faults(bus) if isinstance(bus, CanBusParameters) else _faults_of_line(scene):
            faults.add(section.value_at(key), message)
        if before < index and (bus.channel is not None or not is_virtual[index]):
            text = f"interface {bus.interface!r}, channel {shown(bus.channel)} is bus {names[before]!r} already"
            faults.add(section.value_at("channel"), f"{text}; give each bus its own channel")
        if not scene.axes_on(name):
            text = f"no axis is on bus {name!r}; name it in `bus` of an axis, or leave it out"
            faults.add(section.value_at("name"), text)
        if is_virtual[index] and scene.simulation is None and bus.channel is None:
            faults.add(
                section.value_at("interface"),
                "interface 'virtual' reaches no drive outside this process, and the scene has no `simulation`; "
                "add one, or name the interface and channel of the real bus (interface: socketcan, channel: can0)",
            )
    if len(set(is_virtual)) > 1:
        at = bus_section(sections, is_virtual.index(True)).value_at("interface")
        text = "got 'virtual' together with a bus of another interface"
        faults.add(at, f"{text}; either all buses are inside this process, or none")
    unknown = [name for name in (scene.bus_effects and scene.bus_effects.buses) or () if name not in names]
    if unknown:
        known = ", ".join(filter(None, names)) or "none, the scene's bus has no name"
        at = sections["simulation"]["bus"].value_at("buses")
        faults.add(at, f"got {', '.join(map(repr, unknown))}, which names no bus of the scene; expected: {known}")


def _faults_of_line(scene: Scene) -> Iterator[tuple[str, str]]:
    """Yield the keys of an EtherCAT line that cannot be served."""
    positions = sorted(getattr(axis.parameters, "position", 0) for axis in scene.axes_on(scene.bus_name))
    if scene.simulation is None:  # drives, couplers and terminals without an axis may lie between
        return
    if positions != list(range(len(positions))):
        yield "type", f"got axes at positions {positions} of the line, expected 0 to {len(positions) - 1}: one each"


def _faults_of_loop(of: _Checked, axis_map: AxisMap | None) -> Iterator[tuple[str, str]]:
    """Yield the declarations about the loop of an axis that contradict each other or its bus."""
    axis, bus, loop, late = of.axis, of.bus, of.axis.loop, quirks_of(of.axis.parameters.quirks).syncs_late
    if loop.delay < bus.delay + late:
        with_quirk = f", and its quirks by {late} more" if late else ""
        text = f"got {loop.delay}, but bus.rpdo: {bus.rpdo} delays the torque by {bus.delay} hold"
        yield "delay", f"{text}{with_quirk}; leave it out, or set rpdo: event"
    friction, bound = loop.device_friction or 0.0, loop.device_friction_bound
    if bound is not None and friction > bound and rests_on_hand_force(of.passivity):
        unit = effort_unit(axis.parameters.unit)
        text = f"got {friction:g} {unit} at least, but device_friction_bound says {bound:g} {unit} at most"
        yield "device_friction", f"{text}; measure both (canhaptic commission)"
    cogging, stiffness = loop.device_cogging_bound, loop.presliding_stiffness
    if (cogging is None) is not (stiffness is None) or (cogging or 0.0) > (bound or 0.0):
        text = "friction brakes only where device_friction_bound, device_cogging_bound within it and"
        key = "presliding_stiffness" if cogging is None else "device_cogging_bound"
        yield key, f"{text} presliding_stiffness are all declared; declare them, or leave the last two out"
    if abs(loop.sample_time - bus.sample_time) > 1e-9:
        text = f"got {loop.sample_time:g} s, but bus.rate of {bus.rate:g} Hz makes it {bus.sample_time:g} s"
        yield "sample_time", f"{text}; leave it out"
    for key, least in of.least.items():
        if least > 0.0 and getattr(loop, key) == 0.0:
            yield key, f"got 0 s, but the simulated drive and bus make it {least:g} s; declare it, or leave it out"
    if axis_map is None or not of.is_real or bus.rpdo != "event" or loop.torque_window is None:
        return
    if loop.torque_window < (least := shortest_answer(bus.bitrate, axis_map)):  # as carried over from a simulation
        text = f"got {loop.torque_window:g} s, but SYNC, TPDO and RPDO take {least:.3g} s at least at {bus.bitrate:g}"
        yield "torque_window", f"{text} bit/s; measure it (canhaptic commission), or set rpdo: synchronous"


def _check_controllers(scene: Scene, marks: Mapping[str, SourceLocation], faults: Diagnostics) -> None:
    """Build the controller of each port once, so that it reports what it refuses."""
    for port in scene.ports:
        try:
            if port.axes[0].guard != FAR and all(axis.is_read for axis in port.axes):
                controller_of(scene, port)
        except ParameterError as error:
            faults.add(marks[port.name], str(error))


def _check_far(scene: Scene, sections: MarkedMapping, faults: Diagnostics) -> None:
    """Note what of a section `far` this rig cannot render."""
    if scene.far is None:
        return
    section = sections["far"]
    from canhaptic.far.parameters import LOOPBACK, faults_of
    from canhaptic.scene.far_findings import round_trip

    axis = scene.far_axis
    alone = [axis.parameters.name for axis in scene.axes if not axis.group and not axis.parameters.admittance]
    if axis is None or axis.parameters.name not in alone:
        text = f"got {scene.far.axis!r}, expected the name of a torque axis outside groups"
        ways = ", ".join(alone) or "there is none here; a group has no far side, take the axis out of it"
        faults.add(section.value_at("axis"), f"{text}: {ways}")
        return
    if scene.far.peer == LOOPBACK and not scene.simulated:
        text = f"got {LOOPBACK}, which is for simulated rigs; expected the address of the other rig"
        faults.add(section.value_at("peer"), text)
    try:
        port = build_far_port(scene, axis)
    except ParameterError as error:
        faults.add(section.value_at("axis"), str(error))
        return
    trip, reserve, unit = round_trip(scene), port.reserve(port.held), stiffness_unit(axis.parameters.unit)
    for key, text in faults_of(scene.far, reserve, is_real=not scene.simulated, round_trip=trip, unit=unit):
        faults.add(section.value_at(key), text)


def _check_dictionary(of: _Checked, faults: Diagnostics) -> AxisMap | None:
    """Note every reason why the drive's dictionary is unfit; return the PDO map if it is fit."""
    kind = kind_of(of.bus)
    given, at = of.axis.parameters, of.entry.value_at(DICTIONARIES[kind])
    try:
        dictionary = given.dictionary()
    except DictionaryError as error:
        faults.add(at, str(error))
        return None
    findings = findings_on(dictionary, given, of.bus)
    refusals = [finding for finding in findings if finding.verdict is Verdict.REFUSED]
    for finding in refusals:
        faults.add(at, f"{given.dictionary_path}: {finding.item}: {finding.text}")
    if of.is_real and (text := limit_objection(dictionary, given)):
        faults.add(of.entry.value_at("admittance"), f"{given.dictionary_path}: 0x6072 max torque: {text}")
    return None if refusals or kind != "can" else choose_map(dictionary, given)


def findings_on(dictionary: DriveDictionary, axis: AxisParameters, bus: BusParameters) -> list[Finding]:
    """Return the findings on the dictionary of a drive for its kind of bus."""
    if isinstance(bus, CanBusParameters):
        return check_dictionary(dictionary, axis, bus)
    of_image: list[Finding] = part(kind_of(bus), "findings")(dictionary, axis)
    return [*profile_findings(dictionary, axis, bus.sample_time_ns), *of_image]
