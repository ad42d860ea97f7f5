"""Which faults does a run survive, and what is left of the torque and of the account where it does not?

The demo, in contact, in lock-step; each fault begins 0.5 s after the first SYNC. Columns: why the rig stopped, what the
drive ended in, the sample times from the fault until its torque was zero for good, the most that the link policy allows
for it, the least energy that the wall had
truly taken in (below zero it has given some out), the most by which the account ever exceeded the energy that truly
came in, with the bound of what the encoder can hide (half a count times the variation of the torque), and the records
that the exception carries. `-`: the run went on to its end. Met: torque never beyond its limit and zero at the end,
drive disabled in the cycles allowed, and both energies within the bound.

The cycles allowed follow from the configuration: `bus.stop_cycles` until a silence is a loss, three more for the SYNC
that is counted last and the stop, for losses by chance twice the mean after which they have used up the budget of
`bus.loss_limit`, one round of the stop's own escalation where RPDO and SDO are lost together; for
all that takes the heartbeat of master or drive away, `bus.heartbeat_timeout`. Zero for good is when the simulated drive
says so, not when a frame tells it.
"""

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import cast

import can
from rich.console import Console
from rich.table import Table

from canhaptic.cycle import run
from canhaptic.drive.clock import VirtualClock
from canhaptic.errors import RigError
from canhaptic.scene.build import Experiment, build
from canhaptic.scene.load import load_scene
from canhaptic.sim.drive.profile.state_machine import DriveState
from canhaptic.sim.drive.profile.timers import NEVER
from tools.bench.demo import CONFIG, IN_CONTACT, PERIOD, AccountWatch, drive_of
from tools.bench.report import out_folder, write_result
from tools.truth.faults import JumpingBus

BEGIN, CYCLES = 500, 1_500
LIMIT = 20.0  # [N]
CHANNEL = "faults of the bench"
SCENE = (
    *IN_CONTACT,
    "environment.side=above",
    f"bus.channel={CHANNEL}",
)  # the hand is in the wall for the first second
FROM_BEGIN = "during: [{begin: 0.5 s, duration: 1000 s}]"
ON_THE_BUS = {
    "1 % of frames lost": f"drop: 0.01, {FROM_BEGIN}",
    "10 % of frames lost, three in a row": f"drop: 0.1, drop_burst: 3, {FROM_BEGIN}",
    "half of the TPDOs lost": f"drop: 0.5, ids: [0x181], {FROM_BEGIN}",
    "5 % of frames twice": f"duplicate: 0.05, {FROM_BEGIN}",
    "2 % of TPDOs and RPDOs overtaken": f"reorder: 0.02, ids: [0x181, 0x201], {FROM_BEGIN}",
    "2 % of TPDOs cut short": f"truncate: 0.02, ids: [0x181], {FROM_BEGIN}",
    "jitter of 0.3 ms": f"jitter: 0.3 ms, {FROM_BEGIN}",
    "2000 foreign frames a second": f"foreign_rate: 2000, {FROM_BEGIN}",
    "every TPDO lost": f"drop: 1, ids: [0x181], {FROM_BEGIN}",
    "every RPDO lost": f"drop: 1, ids: [0x201], {FROM_BEGIN}",
    "every RPDO and SDO lost": f"drop: 1, ids: [0x201, 0x601], {FROM_BEGIN}",
    "every RPDO, SDO and SYNC lost": f"drop: 1, ids: [0x201, 0x601, 0x080], {FROM_BEGIN}",
    "everything from the master lost": f"drop: 1, direction: to_drive, {FROM_BEGIN}",
    "everything lost, both ways": f"drop: 1, {FROM_BEGIN}",
    "every SYNC lost": f"drop: 1, ids: [0x080], {FROM_BEGIN}",
    "the drive's heartbeat lost": f"drop: 1, ids: [0x701], {FROM_BEGIN}",
    "the master's heartbeat lost": f"drop: 1, ids: [0x77E], {FROM_BEGIN}",
    "bus frozen for 10 ms": "freeze: [{begin: 0.5 s, duration: 10 ms}]",
    "bus frozen for 200 ms": "freeze: [{begin: 0.5 s, duration: 200 ms}]",
    "host stalled for 50 ms": "stall: [{begin: 0.5 s, duration: 50 ms}]",
    "host stalled for 500 ms": "stall: [{begin: 0.5 s, duration: 500 ms}]",
    "host late for 45 of every 50 ms": "stall: [{begin: 0.5 s, duration: 45 ms, every: 50 ms}]",
    "bus-off for 50 ms": "bus_off: [{begin: 0.5 s, duration: 50 ms}]",
    "bus-off for good": "bus_off: [{begin: 0.5 s, duration: 1000 s}]",
}


def _fault(experiment: Experiment) -> None:
    drive_of(experiment).inject_fault(0x2310)


def _command(*data: int) -> Callable[[Experiment], None]:
    def send(experiment: Experiment) -> None:
        experiment.rig.drives[0].link.send(0x000, bytes(data))

    return send


def _switch_off(experiment: Experiment) -> None:
    experiment.rig.drives[0].link.send(0x601, bytes([0x2B, 0x40, 0x60, 0x00, 0x06, 0, 0, 0]))


def _break_controller(experiment: Experiment) -> None:
    [port] = experiment.cycle.ports
    port.controller = _NotANumber(port.controller)


class _NotANumber:
    def __init__(self, inner: object) -> None:
        self._step = inner.step  # type: ignore[attr-defined]

    def step(self, position: float, torque_applied: float) -> object:
        """Returns a balance whose torque is no number."""
        return self._step(position, torque_applied)._replace(torque=math.nan)


def _foreign(can_id: int, *data: int) -> Callable[[Experiment], None]:
    """A frame from another device on the bus, which the drives and the master hear."""

    def send(_experiment: Experiment) -> None:
        with can.Bus(CHANNEL, interface="virtual") as other:
            other.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    return send


def _jump(experiment: Experiment) -> None:
    """Turns the highest bit but one of every position from now on."""
    link = experiment.rig.drives[0].link
    link._bus = JumpingBus(link._bus)  # noqa: SLF001 - in between


AT_THE_DRIVE = {
    "the drive faults (over-current)": _fault,
    "another master: NMT stop": _command(0x02, 1),
    "another master: NMT reset node": _command(0x81, 1),
    "another master: shutdown by SDO": _switch_off,
    "another master: SYNC": _foreign(0x080),
    "another master: an RPDO of ours": _foreign(0x201, 0x0F, 0, 0xF4, 0x01),
    "another master: an SDO request of ours": _foreign(0x601, 0x40, 0x41, 0x60, 0, 0, 0, 0, 0),
    "the encoder jumps by 2^30 counts": _jump,
    "the controller's torque is not a number": _break_controller,
}

_ESCALATION = 5  # SYNCs of the stop before NMT pre-operational: one with zero torque, four that ask to disable
BY_HEARTBEAT = (
    "every RPDO, SDO and SYNC lost",
    "everything from the master lost",
    "everything lost, both ways",
    "the drive's heartbeat lost",
    "the master's heartbeat lost",
    "bus frozen for 200 ms",
    "host stalled for 500 ms",
    "bus-off for 50 ms",
    "bus-off for good",
)
BY_BUDGET = {"10 % of frames lost, three in a row": 1.0 - 0.9**3, "half of the TPDOs lost": 0.5}
"""Share of the SYNCs that lose their sample or command, of SYNC, TPDO and RPDO."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """One fault; energies in [J]."""

    row: str
    ended: str  # reason of the stop
    drive: str  # state of the drive at the end
    cycles_to_zero: int | None  # None: the run went on
    allowed: int  # by the link policy
    least: float
    overbelieved: float
    bound: float
    records: int
    met: bool


class Watch:
    """Looks at every cycle: when the torque fell to zero, whether it was within its limit, what the account says."""

    def __init__(self, experiment: Experiment, trigger: Callable[[Experiment], None] | None) -> None:
        self._experiment, self._trigger = experiment, trigger
        self.account = AccountWatch(experiment)
        self.within_limit = True
        self._drive = drive_of(experiment)
        self._first_sync: int | None = None
        self._zero_since: int | None = None
        self._triggered: int | None = None
        link = experiment.rig.drives[0].link
        link._recorder = self.hear  # noqa: SLF001 - the only one who sees every frame, those of the stop too
        clock = cast(VirtualClock, experiment.clock)
        far_sides = (*clock._far_sides, self)  # noqa: SLF001 - asked after the drive at each instant
        VirtualClock.__init__(clock, far_sides, clock.now())

    def next_due(self) -> int:
        """Has nothing to do by itself (a `SimulatedPeer`)."""
        return NEVER

    def process(self, now: int) -> None:
        """Called at every instant at which something happens: notes since when the torque is zero."""
        if self._drive.torque:
            self._zero_since = None
        elif self._zero_since is None:
            self._zero_since = now

    def hear(self, timestamp: int, can_id: int, _data: bytes | bytearray, _is_rx: bool) -> None:
        """Called for every frame of the master: notes the first SYNC."""
        if can_id == 0x080 and self._first_sync is None:
            self._first_sync = timestamp

    def cycles_to_zero(self) -> int:
        """Returns the sample times from the fault until the torque was zero."""
        assert self._first_sync is not None
        zero_since = self._experiment.clock.now() if self._zero_since is None else self._zero_since
        fault = self._first_sync + BEGIN * PERIOD if self._triggered is None else self._triggered
        return -(-(zero_since - fault) // PERIOD)

    def look(self, cycles: int) -> None:
        """Called once per cycle."""
        self.within_limit &= abs(self._drive.torque) <= LIMIT
        self.account.look()
        if cycles == BEGIN and self._trigger is not None:
            self._triggered = self._experiment.clock.now()
            self._trigger(self._experiment)


def _allowed(name: str, experiment: Experiment) -> int:
    """Returns the cycles within which the link policy has the torque at zero."""
    bus = experiment.scene.bus
    if name in BY_HEARTBEAT:
        return bus.master_silence_ns // PERIOD + 1
    if name in AT_THE_DRIVE:
        return 3
    if name in BY_BUDGET:
        most = max(10.0, min(bus.stop_cycles, 0.25 / bus.sample_time))
        return round(2.0 * most / (BY_BUDGET[name] - bus.loss_limit))  # twice the mean of a random walk
    if name == "host late for 45 of every 50 ms":
        return round(1.0 / bus.sample_time * 50 / 40) + 50  # 40 more skipped than sent in 50
    return bus.stop_cycles + 3 + (_ESCALATION if name == "every RPDO and SDO lost" else 0)


def outcome(name: str, effects: str | None, trigger: Callable[[Experiment], None] | None) -> Outcome:
    """Runs the demo into one fault."""
    overrides = [*SCENE, *([f"simulation.bus={{{effects}}}"] if effects else [])]
    with build(load_scene(CONFIG, overrides), "free") as experiment:
        watch, records, zero = Watch(experiment, trigger), 0, None
        rig = experiment.rig
        try:
            run(experiment.cycle, CYCLES, progress=watch.look)
        except RigError as error:
            records = len(error.records)
            zero = watch.cycles_to_zero()
        drive = drive_of(experiment)
        judge, allowed = experiment.cycle.judge, _allowed(name, experiment)
        assert judge is not None
        least, over, bound = judge.least[0], watch.account.overbelieved, watch.account.bound
        met = (
            watch.within_limit
            and drive.torque == 0.0
            and drive.state is not DriveState.OPERATION_ENABLED
            and over <= bound
            and least >= -bound
            and (zero is None or (records > 0 and zero <= allowed))
        )
        state = drive.state.name.replace("_", " ")
        return Outcome(name, rig.stop_reason.name, state, zero, allowed, least, over, bound, records, met)


def publish_outcomes(outcomes: list[Outcome]) -> None:
    """Prints the table and writes faults.json."""
    table = Table(title="faults")
    for heading in (
        "fault",
        "ended by",
        "drive",
        "cycles to zero",
        "allowed",
        "least taken in",
        "over-believed",
        "bound",
        "records",
        "met",
    ):
        table.add_column(heading)
    for one in outcomes:
        zero = "-" if one.cycles_to_zero is None else str(one.cycles_to_zero)
        energies = (f"{one.least:.2g} J", f"{one.overbelieved:.2g} J", f"{one.bound:.2g} J")
        table.add_row(
            one.row,
            one.ended,
            one.drive,
            zero,
            str(one.allowed),
            *energies,
            str(one.records or "-"),
            "yes" if one.met else "MISSED",
        )
    Console(width=160).print(table)
    rows = [asdict(one) for one in outcomes]
    write_result(out_folder() / "faults.json", ["canhaptic", "python-can"], {"rows": rows})


def main() -> None:
    """Runs into every fault and publishes the table."""
    outcomes = [outcome(name, effects, None) for name, effects in ON_THE_BUS.items()]
    outcomes += [outcome(name, None, trigger) for name, trigger in AT_THE_DRIVE.items()]
    publish_outcomes(outcomes)


if __name__ == "__main__":
    main()
