"""How a rig ends: zero torque first, then disabled, then pre-operational; confirmed, and without trusting the bus.

Nothing in here raises for a bus or drive that is already failing: each part is tried, and what was not confirmed is
returned as text.
"""

from collections.abc import Callable, Iterable, Sequence
from enum import Enum
from functools import partial
from typing import Final

from canhaptic.canopen.objects import CONTROLWORD, STATUSWORD, Controlword
from canhaptic.drive.profile.cyclic_exchange import CyclicExchange
from canhaptic.drive.profile.power_states import TORQUE_FREE, drive_state
from canhaptic.drive.profile.torque_axis import TorqueAxis
from canhaptic.errors import LinkError, RigError

_LONGEST_RAMP: Final = 50_000_000  # [ns]
_CONFIRMATION: Final = 100_000_000  # [ns] that a drive may take for one step of the stop
_FEWEST_CYCLES: Final = 4  # a synchronous RPDO acts one SYNC later and shows in the TPDO one later still
_ROUNDS: Final = 2  # of SDO and NMT before the loop of PDOs is given up


class Trust(Enum):
    """How far RPDOs and SYNCs are trusted to reach the drives."""

    FULL = "the operator stops a rig that is well"
    SOME = "something is wrong, but not with the link"
    NONE = "the link failed: frames may be lost on any way"


def ramp_down(exchange: CyclicExchange, duration: float) -> None:
    """Take the torque of every axis to zero along a straight line, through the limiter.

    Args:
        exchange: The cycle.
        duration: Duration of the ramp [s], at most 0.05 s.

    Raises:
        LinkError: The bus failed on the way.
        ControlError: Never in practice: the torques are our own.
    """
    ramp = min(round(duration * 1e9), _LONGEST_RAMP)
    cycles = max(1, ramp // exchange.sample_time_ns)
    begin = [drive.limiter.last for drive in exchange.drives]
    for cycle in range(1, cycles + 1):
        exchange.sync()
        for drive, torque in zip(exchange.drives, begin, strict=True):
            drive.sample(0, exchange.periods)
            drive.write(drive.command_per_mille(torque * (1.0 - cycle / cycles)))
        exchange.beat()


def disable(exchange: CyclicExchange, trust: Trust) -> list[str]:
    """Send zero torque, disable every drive and take it to pre-operational.

    Args:
        exchange: The drives.
        trust: Without any, disable goes out by SDO right behind the zero torque: it needs neither RPDO nor SYNC to
            arrive. Unless it is full, SDO and NMT pre-operational follow a few SYNCs later to every drive that may
            still hold a torque.

    Returns:
        What was not confirmed, one text per drive; empty when all is well.
    """
    _try(lambda: _write_zero([drive for drive in exchange.drives if not drive.is_foreign]))
    reachable = [drive for drive in exchange.drives if drive.answers]
    if not reachable:
        return []
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
    return [f"{drive.axis.name}: {problem}" for drive, problem in problems.items() if problem]


def _write_zero(drives: Sequence[TorqueAxis]) -> None:
    """Send zero to every drive, even where the frame of another is refused."""
    failure: LinkError | None = None
    for drive in drives:
        try:
            drive.write(0)
        except LinkError as error:
            failure = error
    if failure is not None:
        raise failure


def _cycle_until_disabled(exchange: CyclicExchange, drives: Sequence[TorqueAxis], *, insists: bool) -> None:
    """Repeat zero torque and disable until every drive confirms; a bus that is off may come back meanwhile.

    After the silence of the master that they tolerate the drives have stopped by their own watchdogs. Where none of
    those that are left shows that it is without torque, disable follows by SDO.
    """
    period, now = exchange.sample_time_ns, exchange.now
    stopping = max([drive.stop_time for drive in drives])  # until then a drive that brakes is left to brake
    patience = now() + stopping
    end = now() + max(_CONFIRMATION, _FEWEST_CYCLES * period, exchange.silence) + stopping
    cycles = rounds = 0
    while now() < end:
        parts = [_try(partial(_write_zero, exchange.drives)), _try(exchange.beat), _try(exchange.sync)]
        if not all(parts):
            exchange.wait_until(now() + period)
            continue
        left = [drive for drive in drives if not _is_disabled(drive)]
        if not left:
            return
        cycles += 1
        if insists and cycles % _FEWEST_CYCLES == 0 and now() >= patience:
            doubtful = [drive for drive in left if not _demands_no_torque(drive)]
            if rounds == _ROUNDS and len(doubtful) == len(left):
                return
            _try_each(drive.disable_unconfirmed for drive in doubtful)
            _try_each(drive.leave_operational for drive in doubtful)
            rounds += 1


def _is_disabled(drive: TorqueAxis) -> bool:
    """Whether the TPDO that answered the last SYNC says so."""
    return drive.is_complete and drive.state in TORQUE_FREE


def _demands_no_torque(drive: TorqueAxis) -> bool:
    """Whether the drive's last TPDO shows no torque, as from a drive that leaves its state slowly."""
    return drive.is_complete and drive.read_back == "demand" and drive.reported_per_mille == 0


def _confirm_disabled(drive: TorqueAxis) -> str:
    """Error of a drive that should be disabled; asks by SDO, for its TPDO did not show it."""
    try:
        drive.sdo.write(CONTROLWORD, 0, Controlword.DISABLE_VOLTAGE)
        state = drive_state(drive.sdo.read(STATUSWORD))
    except RigError as error:
        return str(error)
    return "" if state in TORQUE_FREE else f"state {state.value}"


def _leave_operational(drives: Sequence[TorqueAxis]) -> None:
    """Send the drives to pre-operational, switch their watchdogs off and wait for their heartbeats."""
    _try_each(drive.leave_operational for drive in drives)
    for drive in drives:
        _try(drive.disarm)
        _try(drive.await_pre_operational)


def _try(action: Callable[[], object]) -> bool:
    """Run one part of the stop; return False when bus or drive failed, so that the other parts still happen."""
    try:
        action()
    except RigError:
        return False
    return True


def _try_each(actions: Iterable[Callable[[], object]]) -> None:
    for action in actions:
        _try(action)
