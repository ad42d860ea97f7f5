"""Whether a CANopen dictionary is fit for cyclic torque: the profile, then heartbeat, watchdog and PDOs."""

from collections.abc import Iterator

from canopen import ObjectDictionary

from canhaptic.canopen import objects as od
from canhaptic.canopen.objects import DataType, is_writable
from canhaptic.drive.axis_parameters import AxisParameters, BusParameters
from canhaptic.drive.can.pdo_map import PdoPlan, choose_map, others_to_disable, rpdo_transmission_type
from canhaptic.drive.profile.fitness import Finding, ObjectUse, Verdict, judged, listed, objection, profile_findings
from canhaptic.errors import DictionaryError


def check_dictionary(
    dictionary: ObjectDictionary, axis: AxisParameters, bus: BusParameters | None = None
) -> list[Finding]:
    """Findings of a dictionary about cyclic torque, refusals included.

    Args:
        dictionary: Dictionary of the drive.
        axis: Parameters of the axis.
        bus: Bus of the axis; None: unknown, so that values that depend on it are not judged.
    """
    return [
        *profile_findings(dictionary, axis, None if bus is None else bus.sample_time_ns),
        _heartbeat(dictionary, bus),
        _watchdog(dictionary, axis, bus),
        *_sync_period(dictionary),
        _map(dictionary, axis, bus),
    ]


def require_fit(dictionary: ObjectDictionary, axis: AxisParameters, bus: BusParameters | None = None) -> None:
    """Return if the dictionary gives no reason to refuse cyclic torque; raise otherwise.

    Raises:
        DictionaryError: It does; lists every reason.
    """
    refused = [finding for finding in check_dictionary(dictionary, axis, bus) if finding.verdict is Verdict.REFUSED]
    if refused:
        lines = "; ".join(f"{finding.item}: {finding.text}" for finding in refused)
        kind = "cyclic torque" if axis.admittance is None else "an admittance display"
        raise DictionaryError(f"{axis.name}: {axis.eds} is not fit for {kind}: {lines}")


def _heartbeat(dictionary: ObjectDictionary, bus: BusParameters | None) -> Finding:
    values = () if bus is None else (bus.heartbeat_ms,)
    use = ObjectUse(od.PRODUCER_HEARTBEAT_TIME, 0, DataType.UNSIGNED16, reads=True, writes=True, values=values)
    return judged(dictionary, "0x1017 producer heartbeat", use, "without a heartbeat no NMT state can be confirmed")


def _watchdog(dictionary: ObjectDictionary, axis: AxisParameters, bus: BusParameters | None) -> Finding:
    item = "0x1016 consumer heartbeat"
    if not axis.watchdog:
        return Finding(item, Verdict.UNKNOWN, "not armed (watchdog: false); a killed master leaves the torque on")
    values = () if bus is None else (bus.consumer_heartbeat,)
    use = ObjectUse(od.CONSUMER_HEARTBEAT_TIME, 1, reads=True, writes=True, values=values)
    hint = "the drive cannot notice a killed master; set watchdog: false to accept that"
    return judged(dictionary, item, use, hint, "armed at the start")


def _sync_period(dictionary: ObjectDictionary) -> list[Finding]:
    """Return a refusal where 0x1006 is listed and cannot be compared with the sample time; it may be missing."""
    variable = listed(dictionary, od.COMMUNICATION_CYCLE_PERIOD)
    if variable is None or not variable.readable:
        return []
    use = ObjectUse(od.COMMUNICATION_CYCLE_PERIOD, 0, DataType.UNSIGNED32, reads=True)
    found = judged(dictionary, "0x1006 SYNC period", use, "correct the dictionary")
    return [found] if found.verdict is Verdict.REFUSED else []


def _map(dictionary: ObjectDictionary, axis: AxisParameters, bus: BusParameters | None) -> Finding:
    try:
        chosen = choose_map(dictionary, axis)
    except DictionaryError as error:
        return Finding("PDO map", Verdict.REFUSED, str(error))
    rpdo_type = None if bus is None else rpdo_transmission_type(bus, axis)
    types = [(chosen.rpdo, rpdo_type), *((tpdo, od.SYNCHRONOUS_EVERY_SYNC) for tpdo in chosen.tpdos)]
    refused = [text for plan, kind in types for text in _plan_objections(dictionary, plan, kind)]
    for index in others_to_disable(dictionary, chosen):
        if (text := objection(dictionary, ObjectUse(index, 1, DataType.UNSIGNED32, reads=True))) is not None:
            refused.append(f"{index:#06x}:01 of a PDO to be switched off is {text}")
    if refused:
        return Finding("PDO map", Verdict.REFUSED, "; ".join(refused))
    parts = [
        f"{pdo.name} {pdo.cob_id:#05x} {'written' if pdo.is_written else 'fixed'} "
        f"[{', '.join(str(entry) for entry in pdo.entries)}]"
        for pdo in (chosen.rpdo, *chosen.tpdos)
    ]
    if axis.admittance is None and chosen.read_back != "demand":
        is_measured = chosen.read_back == "actual"
        parts.append(f"energy from the {'measured torque 0x6077' if is_measured else 'commands, not exact'}")
    return Finding("PDO map", Verdict.FIT, "; ".join(parts))


def _plan_objections(dictionary: ObjectDictionary, plan: PdoPlan, transmission_type: int | None) -> Iterator[str]:
    """Yield a planned PDO's obstacles to being configured and read back."""
    place, types = plan.communication_index, () if transmission_type is None else (transmission_type,)
    cob_ids = (plan.cob_id | od.COB_ID_INVALID, plan.cob_id) if plan.cob_id_is_written else ()
    stated = getattr(listed(dictionary, place, 2), "default", None)
    is_type_written = is_writable(dictionary, place, 2)
    if not is_type_written and types and isinstance(stated, int) and stated not in types:
        yield f"{plan.name}: {place:#06x}:02 is read-only and {stated}, but {types[0]} is needed"
    uses = [
        ObjectUse(place, 1, reads=True, values=cob_ids),
        ObjectUse(place, 2, reads=True, values=types if is_type_written else ()),
        ObjectUse(plan.mapping_index, 0, reads=True, values=(0, len(plan.entries)) if plan.is_written else ()),
    ]
    for subindex, entry in enumerate(plan.entries, start=1):
        values = (entry.entry,) if plan.is_written else ()
        uses.append(ObjectUse(plan.mapping_index, subindex, DataType.UNSIGNED32, reads=True, values=values))
    for use in uses:
        if (text := objection(dictionary, use)) is not None:
            yield f"{plan.name}: {use.index:#06x}:{use.subindex:02x} is {text}"
    stated = getattr(listed(dictionary, place, 1), "default", None)
    if not plan.cob_id_is_written and isinstance(stated, int) and stated & od.COB_ID_INVALID:
        yield f"{plan.name}: {place:#06x}:01 is read-only and switches the PDO off"
