"""Columns of an energy log: one list that defines the ring's record, the file and the reader."""

from typing import Final, NamedTuple

from canhaptic.axis_units import Motion
from canhaptic.control.balance import Branch, Certificate, EnergyBalance
from canhaptic.logs.ring import RingShape
from canhaptic.quantities import ACCOUNT, NEW_COLUMNS
from canhaptic.signals import CycleTiming, FarRow, Measured, PlantEnergy, Sample

FORMAT_VERSION: Final = 5
"""Version of the format: 2 added `timing/deadline_index` and the quantities of `Measured`, 3 `active`, 4 `digest`, 5
`supplied`."""
_LAST_WITHOUT_SUPPLIED: Final = 4
_LAST_WITHOUT_DIGEST: Final = 3
DIGEST: Final = "digest"
"""Path of the column with the CRC-32 of each row (`row_digests`), which the writer process adds."""
FORMAT_NAME: Final = "canhaptic energy log"

Attribute = str | int | float

_PORTS: Final = "ports/"
GROUP_AXES: Final = "group_axes"
"""`NAME.group_axes`: names of the axes of a group (JSON). The port of a group has an account but no position."""

PHASE: Final = "phase"
"""Column of `timing` of a run that follows the clock of a drive, such as on EtherCAT."""

ACTIVE_LIMITS: Final = "active_limits"
"""`NAME.active_limits`: the finite bounds (`ActiveLimits`) from which the column `active` is computed (JSON)."""

DRY_RUN: Final = "dry_run"
"""Attribute of the log of a dry run, in which no torque was sent; `torque_command` is what the controller requested."""

FRICTION_DECLARED: Final = "friction_declared"
"""`NAME.friction_declared`: declared friction and hand of an axis, see `motion_checks` (JSON)."""

_INTEGERS: Final = {
    "statusword": "u2",
    "fresh": "u1",
    "branch": "u1",
    "certificate": "u1",
    "longest_hold": "u4",
    "uncommanded": "u4",
    "active": "u1",
}
_BALANCE_NAMES: Final = {"torque": "torque_command"}
_MEANINGS: Final = {
    "branch": ", ".join(f"{member.value} {member.name.lower()}" for member in Branch),
    "certificate": ", ".join(f"{member.value} {member.name.lower()}" for member in Certificate),
    "dropped_before": "cycles lost between the row before and this one because the ring was full",
    "sync_index": "index k of the SYNC",
    "phase": "phase of the last frame that was read, of its SYNC0, minus the phase to keep",
    "deadline_index": "sample times since SYNC 0, more than sync_index after skipped SYNCs; times sample_time_ns: time",
    DIGEST: "CRC-32 of the row: every other column in the order of the format, each as 8 bytes, little endian",
}


class PortDescription(NamedTuple):
    """One port of the log: an axis, or a group of axes with one account."""

    name: str
    unit: Motion  # of its position
    state_unit: Motion | None = None  # of the storage's displacement; None: the same
    commands_velocity: bool = False  # an admittance display: `torque_command` holds a velocity


class _LogColumn(NamedTuple):
    """One quantity of the log."""

    path: str  # of its dataset; empty when the ring carries it but the file does not
    unit: str
    dtype: str  # in the file, NumPy notation
    also: str = ""  # second name of a dataset that had another one before 0.4

    @property
    def meaning(self) -> str:
        """Explanation of a quantity that is not self-evident; empty otherwise."""
        name = (self.also or self.path).rpartition("/")[2]
        row = ACCOUNT.get(name) if self.path.startswith(_PORTS) else None
        return _MEANINGS.get(name) or (", ".join(filter(None, (row.title, row.sentence))) if row else "")


class Event(NamedTuple):
    """An event at one SYNC."""

    sync_index: int
    kind: str  # "emcy", "fault", "link", "stop", ...
    port: str  # empty when it concerns the whole rig
    text: str


EVENT_TEXT_SIZES: Final = {"kind": 24, "port": 64, "text": 208}  # [bytes]
EVENT_COLUMNS: Final = {
    "events/sync_index": "<i8",
    **{f"events/{name}": f"S{size}" for name, size in EVENT_TEXT_SIZES.items()},
}
"""Path of each column of the events, and its type."""
EVENT_RING: Final = RingShape("=q" + "".join(f"{size}s" for size in EVENT_TEXT_SIZES.values()), 1024)


class LogSchema(NamedTuple):
    """Columns of a log, with the other data from which the writer process creates the file."""

    ports: tuple[PortDescription, ...]
    sample_time_ns: int
    with_truth: bool
    chunk_rows: int
    synchronise: bool  # after each chunk the file is forced to the disk
    attributes: dict[str, Attribute]
    version: int = FORMAT_VERSION  # of the format
    has_phase: bool = False  # of the host against SYNC0, of a run whose cycle follows the clock of a drive
    with_far: bool = False  # whether an axis is coupled to a far side

    def columns(self) -> list[_LogColumn]:
        """Return the columns in the order in which the ring's record holds them."""
        columns = [_LogColumn("timing/dropped_before", "1", "u4"), _LogColumn("timing/sync_index", "1", "i8")]
        columns += [_LogColumn(f"timing/{name}", "ns", "i8") for name in CycleTiming._fields]
        if self.version > 1:
            columns.append(_LogColumn("timing/deadline_index", "1", "i8"))
        if self.has_phase:
            columns.append(_LogColumn(f"timing/{PHASE}", "ns", "i8"))
        for port in self.ports:
            columns += _port_columns(port, self.version)
        if self.with_truth:
            for port in self.ports:
                columns.append(_LogColumn(f"truth/{port.name}/position", port.unit, "f8"))
                columns += [_LogColumn(f"truth/{port.name}/{name}", "J", "f8") for name in PlantEnergy._fields]
        if self.with_far:
            units = {
                "received": "pJ",
                "wanted": "pJ",
                "position": "m",
                "velocity": "m/s",
                "wall": "m",
                "stiffness": "N/m",
                "damping": "N*s/m",
                "booked": "pJ",
                "sent": "pJ",
            }
            for name in FarRow._fields:
                columns.append(_LogColumn(f"far/{name}", units.get(name, "1"), "f8" if name in units else "i8"))
        return columns

    def stored(self) -> list[_LogColumn]:
        """Return the columns of the file: columns of the ring that have a path, and the column of their digests."""
        digest = [_LogColumn(DIGEST, "1", "u4")] if self.version > _LAST_WITHOUT_DIGEST else []
        return [column for column in self.columns() if column.path] + digest

    def ring(self, capacity: int) -> RingShape:
        """Return the shape of the ring: every field takes 8 bytes, an integer or a float."""
        return RingShape("=" + "".join("d" if column.dtype == "f8" else "q" for column in self.columns()), capacity)


def _port_columns(port: PortDescription, version: int) -> list[_LogColumn]:
    """Return the columns of a port; older formats have fewer of the quantities in `Measured`."""
    names = NEW_COLUMNS | ({"torque_command": "velocity_command"} if port.commands_velocity else {})
    measured = Measured._fields if version > 2 else Measured._fields[:-1] if version > 1 else ()
    columns = [_LogColumn("", "1", "i8")]  # the SYNC index is in /timing, once for all ports
    balance = EnergyBalance._fields if version > _LAST_WITHOUT_SUPPLIED else EnergyBalance._fields[:-1]
    for field in (*Sample._fields[1:], *balance, *measured):
        stored = _BALANCE_NAMES.get(field, field)
        name = names.get(stored, stored)
        motion = port.state_unit or port.unit if name == "state" else port.unit
        also = f"{_PORTS}{port.name}/{name}" if name != stored else ""
        unit, dtype = ACCOUNT[name].unit_on(motion), _INTEGERS.get(field, "f8")
        columns.append(_LogColumn(f"{_PORTS}{port.name}/{stored}", unit, dtype, also))
    return columns
