"""Types exchanged between master and plant once per cycle. SI throughout; times in integer nanoseconds."""

from typing import NamedTuple, Protocol


class Sample(NamedTuple):
    """Position of one axis at one SYNC, and the torque of the hold that ended there.

    The torque is the one held during the hold that ENDED at this SYNC, read back from the drive where possible, so that
    -torque_applied * (position - previous position) is the interaction energy of that hold (eq. 2).
    """

    sync_index: int  # index k of the SYNC, counted from 0 at the first SYNC with the drive enabled
    position: float  # [rad or m] at SYNC k
    torque_applied: float  # [N*m or N] held from SYNC k-1 to SYNC k
    statusword: int  # 0x6041 as sent with the position
    fresh: bool  # False if no TPDO arrived for this SYNC, so that the values are old


class PlantEnergy(NamedTuple):
    """True energies of a simulated axis since its start [J]; each sum is of work done ON the moving mass."""

    motor: float  # work done by the motor torque on the moving mass: sum(tau dq) = -sum(h_i)
    user: float  # work done by the hand on the moving mass
    dissipated: float  # work taken out by friction and other losses, >= 0
    stored: float  # kinetic and elastic energy of the plant, minus its value at the start


class Truth(NamedTuple):
    """True motion and energies of a simulated axis, read at the same SYNC as its Sample."""

    position: float  # true position, without encoder [rad or m]
    energy: PlantEnergy


class Measured(NamedTuple):
    """Figures of a port that its energy balances lack; all except the effort are totals since SYNC 0."""

    energy_resolution: float  # largest |booked - true| sum of interaction [J]
    device_dissipated: float  # by the declared properties of the device, at least [J]
    effort_asked: float  # of the environment's storage at this position; 0 out of contact, and of a group [N or N*m]
    longest_hold: int  # the most sample times for which one torque was held
    uncommanded: int  # holds whose torque was never commanded
    active: int  # `control.verdict.ACTIVE_AT_MOTOR` and `ACTIVE_AT_HANDLE`, each from the first such hold on


class FarRow(NamedTuple):
    """What a port to a far side was given before a step, and what it sent: a row of `far/` in the log."""

    received: float  # largest total that arrived in the session [pJ]
    wanted: float  # largest total that the other side asked for [pJ]
    position: float  # of the other side [m or rad]
    velocity: float  # [m/s or rad/s]
    wall: float  # that the other side has found [m or rad]
    stiffness: float  # of the wall or spring that a program asks for [N/m or N*m/rad]
    damping: float  # of it [N*s/m or N*m*s/rad]
    flags: int  # 1 the other side is ready, 2 linked, 4 a side stops, 8 below the wall, 16 above, 32 spring to a point
    session: int  # number of the session; 0: none
    seen: int  # largest number of a packet of the other side; -1: none
    sequence: int  # number of the packet of this SYNC; -1: none
    booked: float  # total received that is in the account, R [pJ]
    sent: float  # total sent, S [pJ]


class CycleTiming(NamedTuple):
    """Durations within one cycle [ns]."""

    wakeup_lateness: int  # from the deadline of the SYNC until it is handed to the bus
    sync_to_last_tpdo: int  # from there to the last position TPDO taken
    compute: int  # controllers of all axes
    send: int  # limiter, RPDOs packed and handed to the bus


class SimulatedPeer(Protocol):
    """A simulated drive (or several) that shares a bus with the master and is driven by the master's clock."""

    def process(self, now: int) -> None:
        """Handle every frame waiting on its bus and every timer due up to `now` [ns], in order."""

    def next_due(self) -> int:
        """Return the time [ns] of its next timer; a very large number when it has none."""
