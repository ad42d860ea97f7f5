"""Start of a rig; the stop is in `drive.safety.stop`.

All drives are identified before anything is written to one of them. Each is configured, then SYNC is sent, and they
are taken to operational, exchange zero torque, and are enabled.
"""

from collections.abc import Callable, Sequence
from itertools import count
from typing import Final

from canhaptic.canopen import objects as od
from canhaptic.canopen.objects import Controlword, StatusBit
from canhaptic.drive.exchange import Exchange
from canhaptic.drive.profile.bring_up import BringUp, Confirmation
from canhaptic.drive.profile.torque_axis import TorqueAxis
from canhaptic.drive.safety.power_states import FAULTED, PowerState, next_controlword
from canhaptic.host.stop_signal import require_none

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
        StartStoppedError: A signal asked for the end.
    """
    for drive in exchange.drives:
        drive.reset()
        drive.is_ours = False
        drive.sdo.changes, drive.unrestored = [] if drive.restores else None, []
    for drive, bring_up in zip(exchange.drives, bring_ups, strict=True):
        if drive.identifies:
            bring_up.identify()
    for drive, bring_up in zip(exchange.drives, bring_ups, strict=True):
        require_none()
        drive.is_ours = True  # not before all are known: this might be another machine
        bring_up.call()  # all of them first: their heartbeats come while the first is awaited
    exchange.keep_alive_while_waiting(on=True)  # the first drive configured waits for heartbeats from then on
    try:
        _configure_and_enable(exchange, bring_ups)
    finally:
        exchange.keep_alive_while_waiting(on=False)


def _configure_and_enable(exchange: Exchange, bring_ups: Sequence[BringUp]) -> None:
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
    """Run one cycle with zero torque and the controlwords as they are; raise StartStoppedError once a signal came."""
    require_none()
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
                raise bring_up.overdue(wanted.step, wanted.seen(), wanted.expected)


def _exchange_zero_torque(exchange: Exchange, bring_ups: Sequence[BringUp]) -> None:
    """Cycle until every drive answers SYNC, then read back its target torque and its torque demand."""
    _require_order(exchange, bring_ups)
    for drive, bring_up in zip(exchange.drives, bring_ups, strict=True):
        with bring_up.step("zero torque"):
            target = _read(exchange, drive, drive.axis.causality.target)
        if not drive.rests_at(target):
            seen = f"{drive.axis.causality.target:#06x} = {target} after an RPDO with 0"
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
    """Read an object between two heartbeats of the master; further ones go out while the answer is awaited."""
    exchange.beat(at_once=True)
    value = drive.sdo.read(index, subindex)
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
                if not drive.is_operational:
                    remedy = drive.emergency_remedy(exchange.pace.skipped)
                    raise bring_up.refusal("enable", f"{seen}, {drive.state_text}", expected.value, remedy)
                raise bring_up.overdue("enable", seen, expected.value, patience)
            drive.controlword = int(next_controlword(state) or Controlword.DISABLE_VOLTAGE)
        if all(_is_enabled(drive) and drive.is_complete for drive in exchange.drives):
            if opening < 0:
                _confirm_modes(exchange, bring_ups)
                opening = _open_brakes(exchange, bring_ups)
            if exchange.now() >= opening:
                return
        require_none()
        with bring_ups[0].step("bus"):
            exchange.write_zero()
            exchange.sync()


def _confirm_modes(exchange: Exchange, bring_ups: Sequence[BringUp]) -> None:
    """Cycle with zero torque until each drive whose 0x6061 follows only when enabled shows its mode there."""
    for drive, bring_up in zip(exchange.drives, bring_ups, strict=True):
        deadline = exchange.now() + round(drive.axis.step_timeout * 1e9)
        while drive.quirks.shows_mode_when_enabled:
            with bring_up.step("mode of operation"):
                mode = _read(exchange, drive, od.MODES_OF_OPERATION_DISPLAY)
            if mode == drive.mode_code:
                break
            if exchange.now() >= deadline:
                raise bring_up.overdue("mode of operation", f"0x6061 = {mode}", f"{drive.mode_code}")
            _cycle(exchange, bring_ups)


def _open_brakes(exchange: Exchange, bring_ups: Sequence[BringUp]) -> int:
    """Open every brake; return when the slowest is open [ns]: until then the drives hold zero torque."""
    longest = 0.0
    for drive, bring_up in zip(exchange.drives, bring_ups, strict=True):
        brake = drive.axis.brake
        if brake is not None:
            with bring_up.step("brake"):
                drive.command_brake(is_open=True)
                if drive.outputs is not None:
                    seen = _read(exchange, drive, od.DIGITAL_OUTPUTS, 1)
                    bring_up.expect("brake", "0x60FE:01", seen, brake.outputs(drive.outputs, is_open=True))
            longest = max(longest, brake.release_time)
    return exchange.now() + round(longest * 1e9)


def _is_enabled(drive: TorqueAxis) -> bool:
    """Whether a drive is enabled and, if it reports bit 12 late (quirk late_following), has reported it."""
    follows = not drive.quirks.waits_for_following or drive.statusword & StatusBit.FOLLOWS_COMMAND
    return drive.state is PowerState.OPERATION_ENABLED and bool(follows)


def _refuse_fault(exchange: Exchange, drive: TorqueAxis, bring_up: BringUp) -> None:
    if drive.state in FAULTED or drive.emergency is not None:
        remedy = drive.emergency_remedy(exchange.pace.skipped)
        raise bring_up.refusal("enable", bring_up.fault_text(), PowerState.OPERATION_ENABLED.value, remedy)
