"""Whether a CANopen dictionary is fit for cyclic torque: the profile, then heartbeat, watchdog and PDOs."""

from canopen import ObjectDictionary

from canhaptic.canopen import objects as od
from canhaptic.drive.axis_parameters import AxisParameters
from canhaptic.drive.can.pdo_map import choose_map
from canhaptic.drive.profile.fitness import Finding, Verdict, profile_findings
from canhaptic.errors import DictionaryError


def check_dictionary(dictionary: ObjectDictionary, axis: AxisParameters) -> list[Finding]:
    """Returns what a dictionary says about its fitness for cyclic torque, refusals included."""
    return [
        *profile_findings(dictionary, axis),
        _heartbeat(dictionary),
        _watchdog(dictionary, axis),
        _map(dictionary, axis),
    ]


def require_fit(dictionary: ObjectDictionary, axis: AxisParameters) -> None:
    """Returns when nothing in the dictionary speaks against cyclic torque.

    Raises:
        DictionaryError: Something does; lists every reason.
    """
    refused = [finding for finding in check_dictionary(dictionary, axis) if finding.verdict is Verdict.REFUSED]
    if refused:
        lines = "; ".join(f"{finding.item}: {finding.text}" for finding in refused)
        raise DictionaryError(f"{axis.name}: {axis.eds} is not fit for cyclic torque: {lines}")


def _heartbeat(dictionary: ObjectDictionary) -> Finding:
    if od.PRODUCER_HEARTBEAT_TIME not in dictionary:
        text = "missing; without a heartbeat no NMT state can be confirmed"
        return Finding("0x1017 producer heartbeat", Verdict.REFUSED, text)
    return Finding("0x1017 producer heartbeat", Verdict.FIT, "listed")


def _watchdog(dictionary: ObjectDictionary, axis: AxisParameters) -> Finding:
    item = "0x1016 consumer heartbeat"
    if not axis.watchdog:
        return Finding(item, Verdict.UNKNOWN, "not armed (watchdog: false); a killed master leaves the torque on")
    if dictionary.get_variable(od.CONSUMER_HEARTBEAT_TIME, 1) is None:
        text = "missing; the drive cannot notice a killed master; set watchdog: false to accept that"
        return Finding(item, Verdict.REFUSED, text)
    return Finding(item, Verdict.FIT, "armed at the start")


def _map(dictionary: ObjectDictionary, axis: AxisParameters) -> Finding:
    try:
        chosen = choose_map(dictionary, axis)
    except DictionaryError as error:
        return Finding("PDO map", Verdict.REFUSED, str(error))
    parts = [
        f"{pdo.name} {pdo.cob_id:#05x} {'written' if pdo.is_written else 'fixed'} "
        f"[{', '.join(str(entry) for entry in pdo.entries)}]"
        for pdo in (chosen.rpdo, *chosen.tpdos)
    ]
    note = {"demand": "", "actual": "; energy from the measured torque 0x6077", "none": "; energy is believed"}
    return Finding("PDO map", Verdict.FIT, "; ".join(parts) + note[chosen.read_back])
