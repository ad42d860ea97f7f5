"""Worst-case load of one CAN bus, computed from the configuration before anything is sent (classic CAN, 11-bit).

A data frame of n bytes takes at most 47 + 8 n bits and floor((34 + 8 n - 1) / 4) stuff bits, interframe space included
(Davis et al. 2007, eq. 1). One cycle holds SYNC, every TPDO, the host's latency, every RPDO, one blocking frame that
had just begun, every heartbeat and the EMCY reserve.

The module also checks that the node IDs of a bus differ, and lists the COB-IDs that only this master may send.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from canhaptic.canopen import objects as od
from canhaptic.drive.axis_parameters import CanBusParameters
from canhaptic.drive.can.link import Link
from canhaptic.drive.can.pdo_map import TORQUE_DEMAND, AxisMap
from canhaptic.drive.can.servo_drive import ServoDrive
from canhaptic.errors import BusBudgetError, InputError

_FRAME_BITS: Final = 47  # without data and stuff bits, with the interframe space


def _worst_case_bits(length: int) -> int:
    """Return the most bits that a frame of `length` data bytes can take on the wire, interframe space included."""
    return _FRAME_BITS + 8 * length + (34 + 8 * length - 1) // 4


def worst_frame() -> int:
    """Return the most bits that any data frame can take on the wire, interframe space included."""
    return _worst_case_bits(8)


class _BudgetRow(NamedTuple):
    """Frames of one kind in a cycle."""

    kind: str
    frames: int
    bits_each: int

    @property
    def bits(self) -> int:
        """Bits of these frames on the wire."""
        return self.frames * self.bits_each


@dataclass(frozen=True, slots=True)
class BusBudget:
    """Worst-case times of the frames of one cycle on one bus."""

    rows: tuple[_BudgetRow, ...]
    bitrate: int  # [bit/s]
    compute_latency: float  # of the host [s]
    sample_time: float  # [s]

    @property
    def worst_cycle(self) -> float:
        """The longest cycle [s]."""
        return sum(row.bits for row in self.rows) / self.bitrate + self.compute_latency

    @property
    def periodic_load(self) -> float:
        """Fraction of the bus time that SYNC and PDOs take in every cycle, 0 to 1."""
        bits = sum(row.bits for row in self.rows if row.kind in ("SYNC", "TPDO", "RPDO"))
        return bits / self.bitrate / self.sample_time

    @property
    def fits(self) -> bool:
        """Whether the worst cycle is no longer than the sample time."""
        return self.worst_cycle <= self.sample_time * (1.0 + 1e-12)

    def arithmetic(self) -> str:
        """Return the sum of the worst cycle as text, term by term."""
        terms = " + ".join(f"{row.frames} {row.kind} x {row.bits_each}" for row in self.rows if row.frames)
        bits = sum(row.bits for row in self.rows)
        on_wire = f"{bits} bits at {self.bitrate / 1000:g} kbit/s = {bits / self.bitrate * 1e6:.0f} us"
        worst = f"{self.worst_cycle * 1e6:.0f} us of {self.sample_time * 1e6:.0f} us"
        return f"{terms} = {on_wire}, + {self.compute_latency * 1e6:.0f} us host = {worst}"


def bus_budget(bus: CanBusParameters, maps: Sequence[AxisMap]) -> BusBudget:
    """Return the worst cycle of a bus that carries these axes."""
    rows = [_BudgetRow("SYNC", 1, _worst_case_bits(0))]
    answers = [length for axis in maps for length in (*axis.awaited, *(tpdo.length for tpdo in axis.tpdos))]
    for kind, lengths in (("TPDO", answers), ("RPDO", [axis.rpdo.length for axis in maps])):
        rows += [_BudgetRow(kind, lengths.count(n), _worst_case_bits(n)) for n in sorted(set(lengths), reverse=True)]
    rows.append(_BudgetRow("frame already on the bus", 1, worst_frame()))
    rows.append(_BudgetRow("heartbeat", len(maps) + 1, _worst_case_bits(1)))
    guarded = sum(axis.watchdog == "life_guarding" for axis in maps)
    rows.append(_BudgetRow("guard request", guarded, _worst_case_bits(0)))
    rows.append(_BudgetRow("EMCY", bus.emcy_reserve, worst_frame()))
    return BusBudget(tuple(rows), bus.bitrate, bus.compute_latency, bus.sample_time)


def torque_latency(bus: CanBusParameters, maps: Sequence[AxisMap]) -> float:
    """Longest time [s] from a SYNC until the torques that answer it have arrived.

    It holds every TPDO and RPDO, the host in between, and one blocking frame before the TPDOs and before the RPDOs.
    """
    rows = [row for row in bus_budget(bus, maps).rows if row.kind in ("TPDO", "RPDO")]
    return (sum(row.bits for row in rows) + 2 * worst_frame()) / bus.bitrate + bus.compute_latency


def shortest_answer(bitrate: float, axis: AxisMap) -> float:
    """Return the shortest time [s] from a SYNC to the arrival of the torque of an axis that answers it.

    It holds SYNC, TPDOs and RPDO of this axis alone, without stuff bits and host.
    """
    lengths = [0, axis.rpdo.length, *[tpdo.length for tpdo in axis.tpdos]]
    return sum([_FRAME_BITS + 8 * length for length in lengths]) / bitrate


def round_rate(limit: float) -> float:
    """Return the highest round rate [Hz] that is not above `limit`; 1 Hz at least."""
    rates = (mantissa * 10**exponent for exponent in range(5) for mantissa in (1, 1.25, 2, 2.5, 4, 5, 8))
    return float(max((rate for rate in rates if rate <= limit), default=1))


def has_room_for_sdo(budget: BusBudget, bus: CanBusParameters) -> bool:
    """Whether each cycle has room for one SDO request after its RPDOs, and the next cycle for the answer.

    The request takes the place of one EMCY, which would end the run, or needs room of its own. The answer has a lower
    priority than every PDO: it is the blocking frame that each cycle reserves.
    """
    request = 0 if bus.emcy_reserve else worst_frame()
    return budget.worst_cycle + request / budget.bitrate <= budget.sample_time * (1.0 + 1e-12)


def require_budget(bus: CanBusParameters, maps: Sequence[AxisMap]) -> BusBudget:
    """Return the budget of a bus, or raise if its cycle does not fit.

    Raises:
        BusBudgetError: The cycle does not fit; the text shows the arithmetic and what would fit.
    """
    budget = bus_budget(bus, maps)
    if not budget.fits:
        fits = "; ".join(_ways_out(bus, maps))
        raise BusBudgetError(f"the cycle does not fit the bus: {budget.arithmetic()}; what fits: {fits}")
    return budget


def _ways_out(bus: CanBusParameters, maps: Sequence[AxisMap]) -> list[str]:
    """Return the remedies for a cycle that does not fit, nearest first."""
    budget = bus_budget(bus, maps)
    most = 1.0 / budget.worst_cycle
    ways = [f"rate: {round_rate(most):g} (at most {most:.0f} Hz)"]
    smaller = _without_read_back(budget, maps)
    if smaller is not None and smaller <= budget.sample_time:
        cost = f"{smaller * 1e6:.0f} us; the energy is then as commanded, not exact"
        ways.append(f"read_back: none on every axis ({cost})")
    for bitrate in (125_000, 250_000, 500_000, 800_000, 1_000_000):
        if bitrate > bus.bitrate and bus_budget(bus.model_copy(update={"bitrate": bitrate}), maps).fits:
            ways.append(f"bitrate: {bitrate}")
            break
    if len(maps) > 1:
        half = bus_budget(bus, maps[: (len(maps) + 1) // 2])
        each = f"{half.worst_cycle * 1e6:.0f} us each; `bus` a list, `bus` of each axis its name"
        ways.append(f"two buses ({each})" if half.fits else "more buses and a lower rate")
    return ways


def _without_read_back(budget: BusBudget, maps: Sequence[AxisMap]) -> float | None:
    """Worst cycle [s] without a torque in any TPDO; None if no written map carries one."""
    saved = 0
    for axis in maps:
        if axis.read_back != "none" and len(axis.tpdos) == 1 and axis.tpdos[0].is_written:
            length = axis.tpdos[0].length
            saved += _worst_case_bits(length) - _worst_case_bits(length - TORQUE_DEMAND.bits // 8)
    return budget.worst_cycle - saved / budget.bitrate if saved else None


def own_frames(link: Link, drives: Sequence[ServoDrive], bus: CanBusParameters) -> dict[int, str]:
    """Return the COB-IDs that only this master may send on a bus, with their names.

    Args:
        link: The bus.
        drives: Drives of the rig; those on other buses are left out.
        bus: Bus with the node ID of the master.
    """
    names = {od.NMT_COB_ID: "NMT", od.SYNC_FRAME_COB_ID: "SYNC"}
    names[od.HEARTBEAT_BASE + bus.master_id] = "heartbeat of the master"
    for drive in drives:
        if drive.link is link:
            names[drive.map.rpdo.cob_id] = f"RPDO of {drive.axis.name}"
            names[od.SDO_REQUEST_BASE + drive.axis.node_id] = f"SDO request to {drive.axis.name}"
            node = drive.axis.causality.force.node
            if node is not None and node.node_id is not None:
                names[od.SDO_REQUEST_BASE + node.node_id] = f"SDO request to the force sensor of {drive.axis.name}"
    return names


def budget_of(drives: Sequence[ServoDrive], bus: CanBusParameters) -> BusBudget:
    """Return the budget of one bus at its own bit rate.

    Args:
        drives: Drives on this bus.
        bus: Bus with the node ID of the master; its bit rate counts where the bus has no drive.

    Raises:
        InputError: Two nodes have one node ID.
        BusBudgetError: The frames of one cycle do not fit the bus.
    """
    names = {bus.master_id: "the master's heartbeat (bus.master_id)"}
    for drive in drives:
        node_id, name = drive.axis.node_id, drive.axis.name
        if node_id in names:
            raise InputError(f"{name}: node_id {node_id} is used by {names[node_id]} on the same bus; change it")
        names[node_id] = name
        sensor = drive.axis.causality.force.node
        if sensor is not None and sensor.node_id is not None:
            if sensor.node_id in names:
                text = f"{name}: admittance.force.node.node_id {sensor.node_id} is used by {names[sensor.node_id]}"
                raise InputError(f"{text} on the same bus; give the sensor another node ID")
            names[sensor.node_id] = f"the force sensor of {name}"
    return require_budget(drives[0].bus if drives else bus, [drive.map for drive in drives])
