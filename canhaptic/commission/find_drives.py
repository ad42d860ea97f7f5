"""Search for drives on the bus and check against the configuration. SDO only; nothing is enabled."""

from collections.abc import Sequence
from functools import partial
from typing import Final

from canhaptic.axis_units import effort_unit
from canhaptic.canopen import objects as od
from canhaptic.commission.findings import StepVerdict
from canhaptic.commission.session import Session
from canhaptic.drive.can.link import Link
from canhaptic.drive.can.servo_drive import ServoDrive
from canhaptic.errors import SdoError, StartError

_NODES: Final = range(1, 128)
_ASK_DEVICE_TYPE: Final = bytes.fromhex("40 00 10 00 00 00 00 00")
_PAUSE: Final = 500_000  # [ns] between two questions: the answers of a slow drive must not pile up
_PATIENCE: Final = 300_000_000  # [ns] for the last of them
_MODES: Final = ("pp", "vl", "pv", "tq", "", "hm", "ip", "csp", "csv", "cst")


def _scan(link: Link, known: Sequence[int], master: int) -> list[int]:
    """Node IDs that answer on a bus besides those of the configuration; each is asked for 0x1000.

    Args:
        link: The bus.
        known: Node IDs of the configuration; they are not asked.
        master: Node ID of the master.

    Raises:
        LinkError: The bus failed.
    """
    answered: set[int] = set()
    asked = [node for node in _NODES if node not in known and node != master]

    def take(node: int, _data: bytearray) -> None:
        answered.add(node)

    for node in asked:
        link.subscribe(od.SDO_RESPONSE_BASE + node, partial(take, node))
    try:
        for node in asked:
            link.send(od.SDO_REQUEST_BASE + node, _ASK_DEVICE_TYPE)
            link.pump(link.clock.now() + _PAUSE)
        link.pump(link.clock.now() + _PATIENCE)
    finally:
        for node in asked:
            link.unsubscribe(od.SDO_RESPONSE_BASE + node)
    return sorted(answered)


def identify(session: Session) -> None:
    """Scan every bus and compare each drive with the configuration and its dictionary.

    Raises:
        StartError: A drive of the configuration does not answer.
    """
    for link in session.rig.links:
        on_link = [n for n, drive in enumerate(session.drives) if drive.link is link]
        known = [session.drives[n].axis.node_id for n in on_link]
        strangers = _scan(link, known, session.scene.bus.master_id)
        found = ", ".join(str(node) for node in sorted([*known, *strangers]))
        text = f"node {', '.join(map(str, strangers))} is not in the configuration: identify it before you go on"
        expected = ", ".join(map(str, sorted(known)))
        session.judged(on_link[0], "nodes on the bus", expected, found, good=not strangers, text=text)
    for axis, drive in enumerate(session.drives):
        _presence(session, axis, drive)
        _identity(session, axis, drive)
        _modes(session, axis, drive)
        _rated_torque(session, axis, drive)


def _presence(session: Session, axis: int, drive: ServoDrive) -> None:
    try:
        device_type = drive.sdo.read(od.DEVICE_TYPE)
    except SdoError as error:
        raise StartError(
            drive.axis.name, "presence", str(error), "an answer", "check power, node ID, bit rate and cable"
        ) from error
    profile = device_type & 0xFFFF
    session.judged(
        axis, "device profile", f"{od.CIA402_PROFILE:#06x}", f"{profile:#06x}", good=profile == od.CIA402_PROFILE,
        text="no CiA 402 drive; check node_id", otherwise=StepVerdict.FAILED,
    )  # fmt: skip
    session.propose(axis, "node_id", None, comment="this drive answered")


def _identity(session: Session, axis: int, drive: ServoDrive) -> None:
    """Compare 0x1018 with the configuration's values, or else with those of the dictionary."""
    information = drive.dictionary.device_information
    expected = {
        "vendor_id": (1, drive.axis.vendor_id, information.vendor_number),
        "product_code": (2, drive.axis.product_code, information.product_number),
    }
    for key, (subindex, demanded, of_dictionary) in expected.items():
        item = key.replace("_", " ")
        try:
            found = drive.sdo.read(od.IDENTITY, subindex)
        except SdoError:
            session.found(axis, item, "", "not readable", StepVerdict.UNKNOWN)
            continue
        wanted = demanded if demanded is not None else of_dictionary
        if not wanted:
            session.found(axis, item, "not given", f"{found:#010x}", StepVerdict.MEASURED)
        else:
            text = "the EDS is of another drive: take the one of this drive and firmware"
            session.judged(axis, item, f"{wanted:#010x}", f"{found:#010x}", good=found == wanted, text=text)
        if demanded is None and found:
            session.propose(axis, key, found, comment="refuses another drive at this node ID")


def _modes(session: Session, axis: int, drive: ServoDrive) -> None:
    try:
        modes = drive.sdo.read(od.SUPPORTED_DRIVE_MODES)
    except SdoError:
        session.found(axis, "modes (0x6502)", "cst", "not readable", StepVerdict.UNKNOWN, "is 0x6060 = 10 accepted?")
        return
    names = ", ".join(name for bit, name in enumerate(_MODES) if name and modes >> bit & 1)
    serves = bool(modes & od.CYCLIC_SYNC_TORQUE_BIT)
    text = "no cyclic synchronous torque: other firmware, or another drive"
    session.judged(axis, "modes (0x6502)", "cst", names, good=serves, text=text, otherwise=StepVerdict.FAILED)


def _rated_torque(session: Session, axis: int, drive: ServoDrive) -> None:
    parameters = drive.axis
    unit = effort_unit(parameters.unit)
    configured = "" if parameters.rated_torque is None else f"{parameters.rated_torque:g} {unit}"
    try:
        counts = drive.sdo.read(od.RATED_TORQUE)
    except SdoError:
        counts = 0
    if not counts:
        text = "the configuration alone says what 1000 per mille are; see the torque scale below"
        session.found(axis, "rated torque (0x6076)", configured, "0 or not readable", StepVerdict.UNKNOWN, text)
        return
    of_motor = counts * drive.quirks.rated_torque_resolution
    at_axis = of_motor * parameters.transmission
    found = f"{at_axis:g} {unit}" + (f" ({of_motor:g} N*m at the motor)" if parameters.transmission != 1.0 else "")
    same = parameters.rated_torque is None or abs(at_axis - parameters.rated_torque) <= 0.01 * parameters.rated_torque
    text = "correct rated_torque or transmission: every torque is wrong by this ratio"
    session.judged(axis, "rated torque (0x6076)", configured, found, good=same, text=text)
