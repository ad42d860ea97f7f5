"""Start and stop of a rig.

The start configures each drive, then sends SYNC, takes the drives to operational, exchanges zero torque, and enables.

The stop sends zero torque first, then disables the drives, then takes them to pre-operational. It asks each drive for a
confirmation and does not rely on the bus: each part is tried even if bus or drive is failing, and what was not
confirmed is returned as text. Values that the start wrote into a drive are restored, last written first, once the drive
reports that it is disabled. A drive in a fault, or a silent one, is left as it is. Objects that command motion are not
restored: they stay at rest.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from enum import Enum
from functools import partial
from itertools import count
from typing import Final

from canhaptic.canopen import objects as od
from canhaptic.canopen.objects import Controlword, StatusBit
from canhaptic.drive.can.exchange import Exchange
from canhaptic.drive.profile.bring_up import BringUp, Confirmation
from canhaptic.drive.profile.power_states import FAULTED, TORQUE_FREE, PowerState, next_controlword
from canhaptic.drive.profile.torque_axis import TorqueAxis, Written
from canhaptic.errors import LinkError, RigError, SdoError

_WRAP: Final = 1 << 32
_AFTER: Final[dict[int, PowerState]] = {  # state after a controlword
    Controlword.SHUTDOWN: PowerState.READY_TO_SWITCH_ON,
    Controlword.SWITCH_ON: PowerState.SWITCHED_ON,
    Controlword.ENABLE_OPERATION: PowerState.OPERATION_ENABLED,
}


def start(exchange: Exchange, bring_ups: Sequence[BringUp]) -> None:
    """Take every drive to OPERATION ENABLED with zero torque; return after the first SYNC that found all enabled.

    Args:
        exchange: Cyclic exchange of the rig.
        bring_ups: One for each drive of the exchange, in its order.

    Raises:
        StartError: A step was not confirmed.
    """
    for drive in exchange.drives:
        drive.reset()
        drive.answers = drive.is_foreign = False
        drive.sdo.changes, drive.unrestored = [] if drive.restores else None, []
    for bring_up in bring_ups:
        bring_up.call()  # all of them first: their heartbeats come while the first is awaited
    for bring_up in bring_ups:
        bring_up.configure()
    exchange.begin()
    for drive, bring_up in zip(exchange.drives, bring_ups, strict=True):
        drive.controlword = int(Controlword.DISABLE_VOLTAGE)
        bring_up.command_operational()
    _cycle_until(exchange, bring_ups, lambda bring_up: bring_up.operational())
    _exchange_zero_torque(exchange, bring_ups)
    _check_positions(exchange, bring_ups)
    for bring_up in bring_ups:
        bring_up.check_rest()
    _enable(exchange, bring_ups)


def _cycle(exchange: Exchange, bring_ups: Sequence[BringUp]) -> None:
    """Run one cycle with zero torque and the controlwords as they are."""
    with bring_ups[0].step("bus"):
        exchange.sync()
        exchange.write_zero()


def _cycle_until(
    exchange: Exchange, bring_ups: Sequence[BringUp], confirmation: Callable[[BringUp], Confirmation]
) -> None:
    """Cycle until every drive has confirmed; ask a silent one again at intervals.

    Raises:
        StartError: A drive did not confirm in time.
    """
    begin = exchange.now()
    awaited = [confirmation(bring_up) for bring_up in bring_ups]
    for cycle in count():
        _cycle(exchange, bring_ups)
        if all(wanted.is_given() for wanted in awaited):
            return
        for drive, bring_up, wanted in zip(exchange.drives, bring_ups, awaited, strict=True):
            if wanted.is_given():
                continue
            # Heartbeats after which a drive that has not confirmed is asked again
            if (cycle + 1) % (3 * exchange.beat_cycles) == 0:
                wanted.ask()
            if exchange.now() - begin > round(drive.axis.step_timeout * 1e9):
                raise bring_up.refusal(wanted.step, wanted.seen(), wanted.expected)


def _exchange_zero_torque(exchange: Exchange, bring_ups: Sequence[BringUp]) -> None:
    """Cycle until every drive answers SYNC, then read back its target torque and its torque demand."""
    _require_order(exchange, bring_ups)
    for drive, bring_up in zip(exchange.drives, bring_ups, strict=True):
        with bring_up.step("zero torque"):
            target = _read(exchange, drive, drive.axis.target)
        if not drive.rests_at(target):
            seen = f"{drive.axis.target:#06x} = {target} after an RPDO with 0"
            raise bring_up.refusal("zero torque", seen, drive.rest_text)
        if drive.read_back == "demand" and drive.reported_per_mille != 0:
            raise bring_up.refusal("zero torque", f"0x6074 = {drive.reported_per_mille} in the TPDO", "0")


def _require_order(exchange: Exchange, bring_ups: Sequence[BringUp]) -> None:
    """Cycle until every drive answers two SYNCs and sends nothing in a pause of one cycle between them.

    A frame in the pause answers an older SYNC or none, and would be taken for the answer to the next.
    """
    drives, begin = exchange.drives, exchange.now()
    while True:
        _cycle_until(exchange, bring_ups, lambda bring_up: bring_up.process_data())
        with bring_ups[0].step("bus"):
            exchange.leave_one_out()
        before = [drive.unasked for drive in drives]
        _cycle(exchange, bring_ups)  # a synchronous RPDO acts only now
        wrong = [n for n, drive in enumerate(drives) if drive.unasked > before[n] or not drive.is_complete]
        if not wrong:
            return
        drive, bring_up = drives[wrong[0]], bring_ups[wrong[0]]
        if exchange.now() - begin > round(drive.axis.step_timeout * 1e9):
            is_late = drive.unasked > before[wrong[0]]
            seen = "process data that answer no SYNC, or an older one" if is_late else "no answer to one of two SYNCs"
            wanted = "each SYNC answered within the fraction tpdo_timeout of its cycle, and nothing sent in between"
            remedy = "set transmission type 1, inhibit time 0 and event timer 0 of that TPDO (0x1800 and up), or lower "
            raise bring_up.refusal("PDO exchange", f"{drive.culprit}: {seen}", wanted, f"{remedy}bus.rate")


def _read(exchange: Exchange, drive: TorqueAxis, index: int, subindex: int = 0) -> int:
    """Read an object between two heartbeats of the master, since none goes out while the answer is awaited."""
    exchange.beat(at_once=True)
    value = drive.sdo.read_within(exchange.silence // 2, index, subindex)
    exchange.beat(at_once=True)
    return value


def _check_positions(exchange: Exchange, bring_ups: Sequence[BringUp]) -> None:
    """Compare the position in the TPDO with the one by SDO: a map that is shifted shows here, before any torque."""
    for drive, bring_up in zip(exchange.drives, bring_ups, strict=True):
        with bring_up.step("position"):
            by_sdo = _read(exchange, drive, od.POSITION_ACTUAL)
        by_tpdo = drive.position_counts
        distance = (by_tpdo - by_sdo + _WRAP // 2) % _WRAP - _WRAP // 2
        if abs(distance) >= 1 << 15:  # a shifted map is wrong by 2^16 and more; a hand moves less between two frames
            seen = f"{by_tpdo} counts in the TPDO"
            raise bring_up.refusal("position", seen, f"{by_sdo} counts, as read by SDO (0x6064)")


def _enable(exchange: Exchange, bring_ups: Sequence[BringUp]) -> None:
    """Walk every drive through 0x06, 0x07, 0x0F, each confirmed by the statusword before the next."""
    begin = dict.fromkeys(exchange.drives, exchange.now())
    states = {drive: drive.state for drive in exchange.drives}
    opening = -1
    while True:
        for drive, bring_up in zip(exchange.drives, bring_ups, strict=True):
            _refuse_fault(exchange, drive, bring_up)
            state, now = drive.state, exchange.now()
            if state is not states[drive]:
                states[drive], begin[drive] = state, now
            patience = max(drive.axis.step_timeout, drive.quirks.enable_time)  # for one step of the enabling
            if not _is_enabled(drive) and now - begin[drive] > round(patience * 1e9):
                seen = f"{state.value} (statusword {drive.statusword:#06x}) after controlword {drive.controlword:#04x}"
                expected = _AFTER.get(drive.controlword, PowerState.SWITCH_ON_DISABLED)
                raise bring_up.refusal("enable", seen, expected.value)
            drive.controlword = int(next_controlword(state) or Controlword.DISABLE_VOLTAGE)
        if all(_is_enabled(drive) and drive.is_complete for drive in exchange.drives):
            opening = _open_brakes(exchange, bring_ups) if opening < 0 else opening
            if exchange.now() >= opening:
                return
        with bring_ups[0].step("bus"):
            exchange.write_zero()
            exchange.sync()


def _open_brakes(exchange: Exchange, bring_ups: Sequence[BringUp]) -> int:
    """Open every brake; return when the slowest is open [ns]: until then the drives hold zero torque."""
    longest = 0.0
    for drive, bring_up in zip(exchange.drives, bring_ups, strict=True):
        brake = drive.axis.brake
        if brake is not None:
            with bring_up.step("brake"):
                drive.command_brake(is_open=True)
                if brake.output is not None:
                    seen = _read(exchange, drive, od.DIGITAL_OUTPUTS, 1)
                    bring_up.expect("brake", "0x60FE:01", seen, drive.outputs | 1 << brake.output)
            longest = max(longest, brake.release_time)
    return exchange.now() + round(longest * 1e9)


def _is_enabled(drive: TorqueAxis) -> bool:
    """Whether a drive is enabled and, if it reports bit 12 late (quirk late_following), has reported it."""
    follows = not drive.quirks.waits_for_following or drive.statusword & StatusBit.FOLLOWS_COMMAND
    return drive.state is PowerState.OPERATION_ENABLED and bool(follows)


def _refuse_fault(exchange: Exchange, drive: TorqueAxis, bring_up: BringUp) -> None:
    if drive.state in FAULTED or drive.emergency is not None:
        code = 0 if drive.emergency is None else drive.emergency.code
        from canhaptic.canopen.code_texts import emcy_remedy

        remedy = emcy_remedy(code, exchange.silence * 1e-9, exchange.skipped)
        raise bring_up.refusal("enable", bring_up.fault_text(), PowerState.OPERATION_ENABLED.value, remedy)


_FEWEST_CYCLES: Final = 4  # a synchronous RPDO acts one SYNC later and shows in the TPDO one later still


class Trust(Enum):
    """How certain it is that RPDOs and SYNCs reach the drives."""

    FULL = "the operator stops a rig that is well"
    SOME = "something is wrong, but not with the link"
    NONE = "the link failed: frames may be lost on any way"


def ramp_down(exchange: Exchange, duration: float) -> None:
    """Ramp the torque of every axis linearly to zero, through the limiter; a brake that the host operates is set first.

    Args:
        exchange: Cyclic exchange of the rig.
        duration: Duration of the ramp [s], at most 0.05 s.

    Raises:
        LinkError: The bus failed on the way.
        ControlError: Never in practice: the torques are our own.
    """
    cycles = max(1, min(round(duration * 1e9), 50_000_000) // exchange.sample_time_ns)
    begin = [(drive, drive.limiter.last, _set_brake(drive, exchange.sample_time_ns)) for drive in exchange.drives]
    for cycle in range(1, cycles + max(wait for _, _, wait in begin) + 1):
        exchange.sync()
        for drive, torque, wait in begin:
            drive.sample(0, exchange.periods)
            share = 1.0 - (cycle - wait) / cycles
            drive.write(drive.command_per_mille(torque * min(1.0, max(0.0, share))))
        exchange.beat()


def _set_brake(drive: TorqueAxis, sample_time_ns: int) -> int:
    """Command the brake of an axis to set; return the cycles until it holds, with the torque kept meanwhile."""
    brake = drive.axis.brake
    if brake is None:
        return 0
    drive.command_brake(is_open=False)
    if brake.by == "drive":
        drive.controlword = int(Controlword.SWITCH_ON)  # disable operation: the drive holds until its brake does
    return -(-round(brake.set_time * 1e9) // sample_time_ns) + 2  # an RPDO acts a SYNC later


def disable(exchange: Exchange, trust: Trust) -> list[str]:
    """Send zero torque, disable every drive and take it to pre-operational.

    Args:
        exchange: Cyclic exchange of the rig.
        trust: With no trust, disable goes out by SDO right after the zero torque: it needs neither RPDO nor SYNC to
            arrive. Unless trust is full, SDO and NMT pre-operational follow a few SYNCs later to every drive that may
            still hold a torque.

    Returns:
        What was not confirmed, one text per drive; empty when all is well.
    """
    _try(lambda: _write_zero([drive for drive in exchange.drives if not drive.is_foreign]))
    reachable = [drive for drive in exchange.drives if drive.answers]
    if not reachable:
        return []
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
    for drive in reachable:
        if drive.sdo.changes:
            _restore(drive, problems.get(drive, ""))
            drive.unrestored += drive.elsewhere
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


def _cycle_until_disabled(exchange: Exchange, drives: Sequence[TorqueAxis], *, insists: bool) -> None:
    """Repeat zero torque and disable until every drive confirms; a bus that is off may come back meanwhile.

    It ends at the latest when the drives' own watchdogs have stopped them. It gives up earlier where, after two rounds
    of SDO and NMT, no remaining drive shows zero torque; the caller then disables by SDO.
    """
    period, now = exchange.sample_time_ns, exchange.now
    stopping = max([drive.stop_time for drive in drives])  # until then a drive that brakes is left to brake
    patience = now() + stopping
    end = now() + max(100_000_000, _FEWEST_CYCLES * period, exchange.silence) + stopping
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
            if rounds == 2 and len(doubtful) == len(left):  # of SDO and NMT before the loop of PDOs is given up
                return
            _try_each(drive.disable_unconfirmed for drive in doubtful)
            _try_each(drive.leave_operational for drive in doubtful)
            rounds += 1


def _is_disabled(drive: TorqueAxis) -> bool:
    """Whether the answer to the last SYNC shows a state without torque."""
    return drive.is_complete and drive.state in TORQUE_FREE


def _demands_no_torque(drive: TorqueAxis) -> bool:
    """Whether the drive's last TPDO shows no torque, as from a drive that leaves its state slowly."""
    return drive.is_complete and drive.read_back == "demand" and drive.reported_per_mille == 0


def _confirm_disabled(drive: TorqueAxis) -> str:
    """Disable a drive by SDO where its TPDO did not show that it is; return the error, "" if it is disabled."""
    try:
        drive.sdo.write(od.CONTROLWORD, 0, Controlword.DISABLE_VOLTAGE)
        state = drive.read_state()
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


def _restore(drive: TorqueAxis, problem: str = "") -> None:
    """Restore what the start wrote; objects that could not be restored are listed in `drive.unrestored`.

    Args:
        drive: Drive that is no longer in operation.
        problem: Reason why it is not known to be disabled; "" where it is disabled.
    """
    changes, drive.sdo.changes = drive.sdo.changes or [], None
    firsts: dict[tuple[int, int], Written] = {}
    for change in changes:
        firsts.setdefault(change.place, change)
    try:
        state = problem or drive.read_state().value
        if state != PowerState.SWITCH_ON_DISABLED.value:
            raise SdoError(f"not restored, because the drive shows {state}", od.STATUSWORD, 0)
        for change in reversed(changes):
            if change.before not in (None, change.after) and not _is_kept(drive, change):
                _put_back(drive, change)
        drive.unrestored = [text for first in firsts.values() if (text := "; ".join(_differences(drive, first)))]
    except SdoError as error:
        why = str(error).removeprefix(f"{drive.axis.name}: ")
        drive.unrestored = [f"{drive.sdo.describe(*place)}: {why}" for place in firsts]


def _is_kept(drive: TorqueAxis, change: Written) -> bool:
    is_limit = change.place[0] in (od.MAX_TORQUE, od.MAX_PROFILE_VELOCITY, od.MAX_MOTOR_SPEED)
    return is_limit and not drive.axis.restore_limits


def _put_back(drive: TorqueAxis, change: Written) -> None:
    """Write one value back; raise SdoError without an answer (an abort shows in `_differences`)."""
    try:
        drive.sdo.write(*change.place, change.before or 0, change.size)
    except SdoError as error:
        if error.code is None:
            raise


def _differences(drive: TorqueAxis, first: Written) -> Iterator[str]:
    """Yield the values of an object now and before the start, where they differ; raise SdoError."""
    name = drive.sdo.describe(*first.place)
    if first.before is None:
        yield f"{name} is {first.after}, unknown before"
    elif (now := drive.sdo.read(*first.place)) != first.before:
        kept = (
            "; the run leaves its limits in the drive, unless restore_limits is true" if _is_kept(drive, first) else ""
        )
        yield f"{name} is {now}, was {first.before} before the run{kept}"
