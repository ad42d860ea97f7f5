"""How a rig ends: zero torque first, then disabled, then pre-operational; confirmed, and without trusting the bus.

Nothing in here raises for a bus or drive that is already failing: each part is tried, and what was not confirmed is
returned as text.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Final

from canhaptic.drive.bring_up import BringUp
from canhaptic.drive.cia402 import TORQUE_FREE, drive_state
from canhaptic.drive.exchange import Exchange
from canhaptic.drive.servo_drive import ServoDrive
from canhaptic.errors import LinkError, RigError
from canhaptic.object_dictionary import CONTROLWORD, NMT_COB_ID, STATUSWORD, Controlword, NmtCommand, NmtState

_LONGEST_RAMP: Final = 50_000_000  # [ns]
_CONFIRMATION: Final = 100_000_000  # [ns] that a drive may take for one step of the stop
_FEWEST_CYCLES: Final = 4  # a synchronous RPDO acts one SYNC later and shows in the TPDO one later still


def ramp_down(exchange: Exchange) -> None:
    """Takes the torque of every axis to zero along a straight line of `stop_ramp` seconds, through the limiter.

    Raises:
        LinkError: The bus failed on the way.
        ControlError: Never in practice: the torques are our own.
    """
    ramp = min(round(exchange.bus.stop_ramp * 1e9), _LONGEST_RAMP)
    cycles = max(1, ramp // exchange.bus.sample_time_ns)
    begin = [drive.limiter.last for drive in exchange.drives]
    for cycle in range(1, cycles + 1):
        exchange.sync()
        for drive, torque in zip(exchange.drives, begin, strict=True):
            drive.sample(0, exchange.periods)
            drive.write(drive.command_per_mille(torque * (1.0 - cycle / cycles)))
        exchange.beat()


def disable(exchange: Exchange) -> list[str]:
    """Sends zero torque at once, disables every drive and takes it to pre-operational.

    Returns:
        What was not confirmed, one text per drive; empty when all is well.
    """
    _try(lambda: _write_zero(exchange.drives))
    reachable = [drive for drive in exchange.drives if drive.answers]
    if not reachable:
        return []
    operational = [drive for drive in reachable if drive.nmt_state == NmtState.OPERATIONAL]
    if operational:
        _try(exchange.sync)  # a synchronous RPDO acts at the next SYNC
    for drive in exchange.drives:
        drive.controlword = int(Controlword.DISABLE_VOLTAGE)
    if operational:
        _cycle_until_disabled(exchange, operational)
    problems = {drive: _confirm_disabled(drive) for drive in reachable}
    _leave_operational([drive for drive in reachable if not problems[drive]])
    return [f"{drive.axis.name}: {problem}" for drive, problem in problems.items() if problem]


def _write_zero(drives: Sequence[ServoDrive]) -> None:
    """Sends zero to every drive, whatever happens to the frames of the others."""
    failure: LinkError | None = None
    for drive in drives:
        try:
            drive.write(0)
        except LinkError as error:
            failure = error
    if failure is not None:
        raise failure


def _cycle_until_disabled(exchange: Exchange, drives: Sequence[ServoDrive]) -> None:
    """Repeats zero torque and disable until every drive confirms; a bus that is off may come back meanwhile.

    After the silence of the master that they tolerate the drives have stopped by their own watchdogs.
    """
    period, now = exchange.bus.sample_time_ns, exchange.clock.now
    end = now() + max(_CONFIRMATION, _FEWEST_CYCLES * period, exchange.bus.master_silence_ns)
    while now() < end:
        parts = [_try(partial(_write_zero, exchange.drives)), _try(exchange.beat), _try(exchange.sync)]
        if not all(parts):
            exchange.clock.wait_until(now() + period)
        elif all(drive.is_complete and drive.state in TORQUE_FREE for drive in drives):
            return


def _confirm_disabled(drive: ServoDrive) -> str:
    """Returns what is wrong with a drive that should be disabled; asks by SDO where the TPDO does not tell."""
    if drive.is_complete and drive.state in TORQUE_FREE:
        return ""
    try:
        drive.sdo.write(CONTROLWORD, 0, Controlword.DISABLE_VOLTAGE)
        state = drive_state(drive.sdo.read(STATUSWORD))
    except RigError as error:
        return str(error)
    return "" if state in TORQUE_FREE else f"state {state.value}"


def _leave_operational(drives: Sequence[ServoDrive]) -> None:
    """Sends the drives to pre-operational, switches their watchdogs off and waits for their heartbeats."""
    for drive in drives:
        command = bytes([NmtCommand.PRE_OPERATIONAL, drive.axis.node_id])
        _try(partial(drive.link.send, NMT_COB_ID, command))
    for drive in drives:
        _try(BringUp(drive).disarm)
        _try(partial(drive.link.wait_for, partial(_is_pre_operational, drive), drive.bus.drive_silence_ns))


def _is_pre_operational(drive: ServoDrive) -> bool:
    return drive.nmt_state == NmtState.PRE_OPERATIONAL


def _try(action: Callable[[], object]) -> bool:
    """Runs one part of the stop; returns False when bus or drive failed, so that the other parts still happen."""
    try:
        action()
    except RigError:
        return False
    return True
