"""The start of a rig after the configuration of each drive: SYNC, operational, zero torque on the wire, enable."""

from collections.abc import Callable, Sequence
from itertools import count
from typing import Final

from canhaptic.canopen.code_texts import emcy_remedy
from canhaptic.canopen.objects import POSITION_ACTUAL, Controlword, StatusBit
from canhaptic.drive.profile.bring_up import BringUp, Confirmation
from canhaptic.drive.profile.cyclic_exchange import CyclicExchange
from canhaptic.drive.profile.power_states import FAULTED, PowerState, next_controlword
from canhaptic.drive.profile.torque_axis import TorqueAxis

_PLAUSIBLE_COUNTS: Final = 1 << 15  # a shifted map is wrong by 2^16 and more; a hand moves less between two frames
_WRAP: Final = 1 << 32
_ORDER: Final = (
    "set transmission type 1, inhibit time 0 and event timer 0 of that TPDO (0x1800 and up), or lower bus.rate"
)
_PATIENCE: Final = 3  # heartbeats after which a drive that has not confirmed is asked again


def start(exchange: CyclicExchange, bring_ups: Sequence[BringUp]) -> None:
    """Take every drive to OPERATION ENABLED with zero torque; return after the first SYNC that found all enabled.

    Args:
        exchange: The cycle.
        bring_ups: One for each drive of the exchange, in its order.

    Raises:
        StartError: A step was not confirmed.
    """
    for drive in exchange.drives:
        drive.reset()
        drive.answers = drive.is_foreign = False
    for bring_up in bring_ups:
        bring_up.call()  # all of them first: their heartbeats come while the first is awaited
    for bring_up in bring_ups:
        bring_up.configure()
    exchange.begin()
    _enter_operational(exchange, bring_ups)
    _exchange_zero_torque(exchange, bring_ups)
    _check_positions(exchange, bring_ups)
    for bring_up in bring_ups:
        bring_up.check_rest()
    _enable(exchange, bring_ups)


def _cycle(exchange: CyclicExchange, bring_ups: Sequence[BringUp]) -> None:
    """One SYNC with zero torque and the controlwords as they are."""
    with bring_ups[0].step("bus"):
        exchange.sync()
        exchange.write_zero()


def _cycle_until(
    exchange: CyclicExchange, bring_ups: Sequence[BringUp], confirmation: Callable[[BringUp], Confirmation]
) -> None:
    """Cycles until every drive has confirmed; those that have not are asked again now and then.

    Raises:
        StartError: One did not within its time.
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
            if (cycle + 1) % (_PATIENCE * exchange.beat_cycles) == 0:
                wanted.ask()
            if exchange.now() - begin > round(drive.axis.step_timeout * 1e9):
                raise bring_up.refusal(wanted.step, wanted.seen(), wanted.expected)


def _enter_operational(exchange: CyclicExchange, bring_ups: Sequence[BringUp]) -> None:
    for drive, bring_up in zip(exchange.drives, bring_ups, strict=True):
        drive.controlword = int(Controlword.DISABLE_VOLTAGE)
        bring_up.command_operational()
    _cycle_until(exchange, bring_ups, lambda bring_up: bring_up.operational())


def _exchange_zero_torque(exchange: CyclicExchange, bring_ups: Sequence[BringUp]) -> None:
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


def _require_order(exchange: CyclicExchange, bring_ups: Sequence[BringUp]) -> None:
    """Cycles until every drive answers two SYNCs, of which the first is followed by a pause, and sends nothing in it.

    What comes in the pause answers an older SYNC, or none: it would be taken for the answer of the next.
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
            seen = "process data that answer no SYNC, or an older one" if is_late else "no answer to one SYNC of two"
            wanted = "each SYNC answered before the part tpdo_timeout of its cycle ends, and nothing sent between"
            raise bring_up.refusal("PDO exchange", f"{drive.culprit}: {seen}", wanted, _ORDER)


def _read(exchange: CyclicExchange, drive: TorqueAxis, index: int) -> int:
    """Read an object while the drives' watchdogs of the master run: no heartbeat goes out until the answer."""
    exchange.beat(at_once=True)
    value = drive.sdo.read_within(exchange.silence // 2, index)
    exchange.beat(at_once=True)
    return value


def _check_positions(exchange: CyclicExchange, bring_ups: Sequence[BringUp]) -> None:
    """Compare the position in the TPDO with the one by SDO: a map that is shifted shows here, before any torque."""
    for drive, bring_up in zip(exchange.drives, bring_ups, strict=True):
        with bring_up.step("position"):
            by_sdo = _read(exchange, drive, POSITION_ACTUAL)
        by_tpdo = drive.position_counts
        distance = (by_tpdo - by_sdo + _WRAP // 2) % _WRAP - _WRAP // 2
        if abs(distance) >= _PLAUSIBLE_COUNTS:
            seen = f"{by_tpdo} counts in the TPDO"
            raise bring_up.refusal("position", seen, f"{by_sdo} counts as by SDO (0x6064)")


def _enable(exchange: CyclicExchange, bring_ups: Sequence[BringUp]) -> None:
    """Walk every drive through 0x06, 0x07, 0x0F, each confirmed by the statusword before the next."""
    begin = dict.fromkeys(exchange.drives, exchange.now())
    states = {drive: drive.state for drive in exchange.drives}
    while True:
        for drive, bring_up in zip(exchange.drives, bring_ups, strict=True):
            _refuse_fault(exchange, drive, bring_up)
            state, now = drive.state, exchange.now()
            if state is not states[drive]:
                states[drive], begin[drive] = state, now
            if not _is_enabled(drive) and now - begin[drive] > _enable_time(drive):
                raise bring_up.refusal("enable", _state_text(drive), _expected_after(drive))
            drive.controlword = int(next_controlword(state) or Controlword.DISABLE_VOLTAGE)
        if all(_is_enabled(drive) and drive.is_complete for drive in exchange.drives):
            return
        with bring_ups[0].step("bus"):
            exchange.write_zero()
            exchange.sync()


def _is_enabled(drive: TorqueAxis) -> bool:
    """Whether a drive is enabled and, if it reports bit 12 late (quirk late_following), has reported it."""
    follows = not drive.quirks.waits_for_following or drive.statusword & StatusBit.FOLLOWS_COMMAND
    return drive.state is PowerState.OPERATION_ENABLED and bool(follows)


def _enable_time(drive: TorqueAxis) -> int:
    """Return how long one step of the enabling may take [ns]."""
    return round(max(drive.axis.step_timeout, drive.quirks.enable_time) * 1e9)


def _refuse_fault(exchange: CyclicExchange, drive: TorqueAxis, bring_up: BringUp) -> None:
    if drive.state in FAULTED or drive.emergency is not None:
        code = 0 if drive.emergency is None else drive.emergency.code
        remedy = emcy_remedy(code, exchange.silence * 1e-9, exchange.skipped)
        raise bring_up.refusal("enable", bring_up.fault_text(), PowerState.OPERATION_ENABLED.value, remedy)


def _state_text(drive: TorqueAxis) -> str:
    return f"{drive.state.value} (statusword {drive.statusword:#06x}) after controlword {drive.controlword:#04x}"


def _expected_after(drive: TorqueAxis) -> str:
    after = {
        Controlword.SHUTDOWN: PowerState.READY_TO_SWITCH_ON,
        Controlword.SWITCH_ON: PowerState.SWITCHED_ON,
        Controlword.ENABLE_OPERATION: PowerState.OPERATION_ENABLED,
    }
    return after.get(Controlword(drive.controlword), PowerState.SWITCH_ON_DISABLED).value
