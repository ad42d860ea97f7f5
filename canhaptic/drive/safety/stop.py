"""Stop of a rig: zero torque first, then the drives are disabled, then they are taken to pre-operational.

It asks each drive for a confirmation and does not rely on the bus: each part is tried even if bus or drive is failing,
and what was not confirmed is returned as text. A drive in a fault, or a silent one, is left as it is.
"""

from collections.abc import Callable, Iterable, Sequence
from enum import Enum
from functools import partial
from typing import Any, Final, Protocol

from canhaptic.canopen import objects as od
from canhaptic.canopen.objects import Controlword
from canhaptic.drive.safety.power_states import TORQUE_FREE, PowerState
from canhaptic.errors import cause_of


class StoppedAxis(Protocol):
    """What the stop needs of an axis: see `drive.profile.torque_axis.TorqueAxis`, which is one."""

    axis: Any  # its parameters
    sdo: Any  # access to its objects
    stop_word: Controlword
    stop_time: int
    controlword: int
    weight: float
    is_ours: bool
    is_operational: bool
    is_complete: bool

    @property
    def read_back(self) -> str:
        """What its process data report of the torque: demand, actual or none."""

    @property
    def state(self) -> PowerState:
        """Power state of the last statusword."""

    @property
    def reported_per_mille(self) -> int:
        """Torque of the last complete process data."""

    def sample(self, sync_index: int, periods: int = 1) -> object:
        """Return the sample of the SYNC just answered, else the last one."""

    def command_per_mille(self, torque: float) -> int:
        """Return the target for a requested torque [N*m or N], after policy and limiter."""

    def write(self, torque_per_mille: int) -> None:
        """Send controlword and target torque; raise LinkError."""

    def command_brake(self, *, is_open: bool) -> None:
        """Open or set a brake operated by the host; raise LinkError."""

    def let_go(self) -> None:
        """Expect that the drive disables itself, because its brake was commanded to hold."""

    def disable_unconfirmed(self) -> None:
        """Disable outside the process data and await no answer; raise LinkError."""

    def leave_operational(self) -> None:
        """Ask the drive to stop exchanging process data; raise LinkError."""

    def await_pre_operational(self) -> None:
        """Return when the drive has confirmed that, or the timeout is over; raise LinkError."""

    def disarm(self) -> None:
        """Switch off the drive's watchdog; raise SdoError."""

    def read_state(self) -> PowerState:
        """Ask the drive for its power state; raise SdoError."""


class StoppedExchange(Protocol):
    """What the stop needs of the cycle on the buses: see `drive.exchange.Exchange`, which is one."""

    sample_time_ns: int
    silence: int

    @property
    def drives(self) -> Sequence[StoppedAxis]:
        """All drives of the rig."""

    @property
    def is_urgent(self) -> bool:
        """Whether nothing is to be awaited any longer."""

    def now(self) -> int:
        """Return the time [ns]."""

    def wait_until(self, deadline: int) -> None:
        """Return when `deadline` [ns] has come."""

    def sync(self) -> None:
        """Run one SYNC with its answers; raise LinkError."""

    def beat(self) -> None:
        """Send the master's heartbeat when it is due; raise LinkError."""


_FEWEST_CYCLES: Final = 4  # a synchronous RPDO acts one SYNC later and shows in the TPDO one later still


class Trust(Enum):
    """How certain it is that RPDOs and SYNCs reach the drives."""

    FULL = "the operator stops a rig that is well"
    SOME = "something is wrong, but not with the link"
    NONE = "the link failed: frames may be lost on any way"


def set_brakes(exchange: StoppedExchange) -> int:
    """Command every brake to set; return the SYNCs until the slowest holds, 0 without one.

    Raises:
        LinkError: It could not be sent.
    """
    return max([_set_brake(drive, exchange.sample_time_ns) for drive in exchange.drives])


def _set_brake(drive: StoppedAxis, sample_time_ns: int) -> int:
    """Command the brake of an axis to set; return the SYNCs until it holds."""
    brake = drive.axis.brake
    if brake is None:
        return 0
    drive.command_brake(is_open=False)
    if brake.by == "drive":
        drive.controlword = int(Controlword.SWITCH_ON)  # disable operation: the drive holds until its brake does
        drive.let_go()
    holds: int = brake.holds_until_set(sample_time_ns)
    return holds


def hold_unseen(exchange: StoppedExchange) -> None:
    """Hold the declared weight of every axis that hangs until its brake does, though no TPDO comes; else send zero.

    The other axes are disabled at once. Nothing is raised: `disable` follows in any case.
    """
    hung = [drive for drive in exchange.drives if drive.weight and drive.is_ours]
    if not hung:
        return
    others = [drive for drive in exchange.drives if drive not in hung and drive.is_ours]
    _try(partial(_write_zero, others))
    _try_each(drive.disable_unconfirmed for drive in others)
    holds = 0
    for drive in hung:
        _try(partial(_hold_weight, drive))
        holds = max(holds, drive.axis.brake.holds_until_set(exchange.sample_time_ns))
    _try(partial(set_brakes, exchange))  # at once: every other torque is gone long before a brake holds
    for _ in range(holds):
        parts = [_try(exchange.sync), _try(partial(_write_zero, others)), _try(exchange.beat)]
        _try_each(partial(_hold_weight, drive) for drive in hung)
        if not all(parts):
            exchange.wait_until(exchange.now() + exchange.sample_time_ns)


def _hold_weight(drive: StoppedAxis) -> None:
    drive.sample(0)
    drive.write(drive.command_per_mille(drive.weight))


def disable(exchange: StoppedExchange, trust: Trust) -> list[str]:
    """Send zero torque, disable every drive and take it to pre-operational.

    Args:
        exchange: Cyclic exchange of the rig.
        trust: With no trust, disable goes out by SDO right after the zero torque: it needs neither RPDO nor SYNC to
            arrive. Unless trust is full, SDO and NMT pre-operational follow a few SYNCs later to every drive that may
            still hold a torque.

    Returns:
        What was not confirmed, one text per drive; "" where all is well, and where nothing was written yet.
    """
    reachable = [drive for drive in exchange.drives if drive.is_ours]
    if not reachable:
        return [""] * len(exchange.drives)
    _try(lambda: _write_zero(reachable))
    _try_each(partial(drive.command_brake, is_open=False) for drive in reachable if drive.axis.brake is not None)
    if trust is Trust.NONE:
        _try_each(drive.disable_unconfirmed for drive in reachable)
    operational = [drive for drive in reachable if drive.is_operational]
    if operational:
        _try(exchange.sync)  # a synchronous RPDO acts at the next SYNC
    for drive in exchange.drives:
        drive.controlword = int(drive.stop_word)
    if operational:
        _cycle_until_disabled(exchange, operational, insists=trust is not Trust.FULL)
    confirmed = [drive for drive in reachable if _is_disabled(drive)]
    _leave_operational(confirmed)  # before any waiting: no heartbeat goes out meanwhile
    others = [drive for drive in reachable if drive not in confirmed]
    _try_each(drive.leave_operational for drive in others if drive not in operational)  # STOPPED takes no SDO
    problems = {drive: _confirm_disabled(drive) for drive in others}
    _leave_operational([drive for drive in others if not problems[drive]])
    return [problems.get(drive, "") for drive in exchange.drives]


def _write_zero(drives: Sequence[StoppedAxis]) -> None:
    """Send zero to every drive, even where the frame of another is refused."""
    failure: Exception | None = None
    for drive in drives:
        try:
            drive.write(0)
        except Exception as error:
            failure = error
    if failure is not None:
        raise failure


def _cycle_until_disabled(exchange: StoppedExchange, drives: Sequence[StoppedAxis], *, insists: bool) -> None:
    """Repeat zero torque and disable until every drive confirms; a bus that is off may come back meanwhile.

    It ends at the latest when the drives' own watchdogs have stopped them. It gives up earlier where, after two rounds
    of SDO and NMT, no remaining drive shows zero torque; the caller then disables by SDO.
    """
    period, now = exchange.sample_time_ns, exchange.now
    ours = [drive for drive in exchange.drives if drive.is_ours]
    stopping = max([drive.stop_time for drive in drives])  # until then a drive that brakes is left to brake
    patience = now() + stopping
    end = now() + max(100_000_000, _FEWEST_CYCLES * period, exchange.silence) + stopping
    cycles = rounds = 0
    while now() < end:
        parts = [_try(partial(_write_zero, ours)), _try(exchange.beat), _try(exchange.sync)]
        if not all(parts):
            exchange.wait_until(now() + period)
            continue
        left = [drive for drive in drives if not _is_disabled(drive)]
        if not left:
            return
        cycles += 1
        if exchange.is_urgent and cycles >= _FEWEST_CYCLES:
            return
        if insists and cycles % _FEWEST_CYCLES == 0 and now() >= patience:
            doubtful = [drive for drive in left if not _demands_no_torque(drive)]
            if rounds == 2 and len(doubtful) == len(left):  # of SDO and NMT before the loop of PDOs is given up
                return
            _try_each(drive.disable_unconfirmed for drive in doubtful)
            _try_each(drive.leave_operational for drive in doubtful)
            rounds += 1


def _is_disabled(drive: StoppedAxis) -> bool:
    """Whether the answer to the last SYNC shows a state without torque."""
    return drive.is_complete and drive.state in TORQUE_FREE


def _demands_no_torque(drive: StoppedAxis) -> bool:
    """Whether the drive's last TPDO shows no torque, as from a drive that leaves its state slowly."""
    return drive.is_complete and drive.read_back == "demand" and drive.reported_per_mille == 0


def _confirm_disabled(drive: StoppedAxis) -> str:
    """Disable a drive by SDO where its TPDO did not show that it is; return the error, "" if it is disabled."""
    try:
        drive.sdo.write(od.CONTROLWORD, 0, Controlword.DISABLE_VOLTAGE)
        state = drive.read_state()
    except Exception as error:
        return cause_of(error)
    return "" if state in TORQUE_FREE else f"state {state.value}"


def _leave_operational(drives: Sequence[StoppedAxis]) -> None:
    """Send the drives to pre-operational, switch their watchdogs off and wait for their heartbeats."""
    _try_each(drive.leave_operational for drive in drives)
    for drive in drives:
        _try(drive.disarm)
        _try(drive.await_pre_operational)


def _try(action: Callable[[], object]) -> bool:
    """Run one part of the stop; return False when it failed, so that the other parts still happen.

    Bus and drive fail by a `RigError`; a driver library, or a process without memory, by anything.
    """
    try:
        action()
    except Exception:
        return False
    return True


def _try_each(actions: Iterable[Callable[[], object]]) -> None:
    for action in actions:
        _try(action)
