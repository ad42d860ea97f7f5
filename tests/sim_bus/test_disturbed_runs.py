"""Whole runs on a bus with faults: they go on, the counts are right to the frame, the ledger never believes too much.

What the ledger believes of a hold is bounded from one side: where positions were lost it books the worst, so that the
believed sum of h_i never exceeds the true one by more than half a count times the variation of the torque, the tight
bound of what an encoder can hide. The truth is the simulated plant's own account.
"""

import itertools
import re
import threading
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import can
import pytest

from canhaptic.cli import drive as drive_command
from canhaptic.control.balance import EnergyBalance
from canhaptic.control.passivity import Controller
from canhaptic.cycle import run
from canhaptic.errors import DriveFaultError, LinkError, RigError, SyncsSkippedError, TpdoContradictedError
from canhaptic.scene.build import Experiment, build
from canhaptic.scene.far_side import build_far_end, with_effects
from canhaptic.scene.load import load_scene
from canhaptic.sim.drive.profile.state_machine import DriveState
from tests.sim_bus.bus_bench import virtual_bus

DEMO = Path(__file__).resolve().parents[2] / "configs" / "demo.yaml"
GUARDED = (
    "passivity={algorithm: guarded, moving_mass: 0.2 kg, hand_force: 0 N, device_damping_bound: 0.1 N*s/m, "
    "sync_jitter: 0, torque_window: 0 s, "  # declared: what the bus makes of them would leave no torque
    "max_consecutive_losses: 4}"
)
PAPER = "passivity={algorithm: internal_dissipation}"
AFTER_THE_START = "during: [{begin: 0.1 s, duration: 1000 s}]"
WITHIN = "during: [{begin: 0.1 s, duration: 0.25 s}]"  # neither in the start nor in the stop of 400 cycles
PATIENT = "bus.loss_limit=1"  # what a tenth of lost frames does to the account is to be seen
QUICK = "axes.0.sdo_timeout=20 ms"  # a lost answer is asked for again before the drive misses the master's heartbeat
IN_AND_OUT = ("environment.position=0", "environment.side=above")  # the hand is in the wall for a second, then out
COUNT = 1e-6  # [m]


class Watched:
    """A controller that notes how its torque varies, as applied."""

    def __init__(self, inner: Controller) -> None:
        self.inner, self.variation, self.last = inner, 0.0, 0.0

    def step(self, position: float, torque_applied: float) -> EnergyBalance:
        self.variation += abs(torque_applied - self.last)
        self.last = torque_applied
        return self.inner.step(position, torque_applied)

    def sample_lost(self) -> EnergyBalance:
        return self.inner.sample_lost()


class Outcome(NamedTuple):
    cycles: int
    link: dict[str, float]
    struck: Counter[tuple[str, str, int]]
    overbelieved: float  # most by which the believed sum of h_i exceeded the true one and the resolution stated [J]
    encoder_bound: float  # [J]
    least: float  # of the true sum of h_i [J]
    energy_in: float  # [J]
    heard: list[can.Message]  # by somebody else on the drives' side of the bus
    error: Exception | None


def disturbed(*overrides: str, cycles: int = 1500) -> Outcome:
    """Runs the demo so many cycles in lock-step, with somebody else listening behind the faults."""
    scene = load_scene(DEMO, [*IN_AND_OUT, PATIENT, "bus.channel=overheard", *overrides])
    with virtual_bus("overheard") as listener, build(scene, "free") as experiment:
        cycle, error = experiment.cycle, None
        [port] = cycle.ports
        inner = port.controller
        watched = port.controller = Watched(inner)
        accounted = Overbelief(experiment, inner)
        try:
            run(cycle, cycles, progress=accounted.look)
        except RigError as raised:
            error = raised
        heard = []
        while (message := listener.recv(0)) is not None:
            heard.append(message)
        assert experiment.far_side is not None
        [drive] = experiment.far_side.drives
        experiment.clock.wait_until(experiment.clock.now() + 300_000_000)
        assert drive.torque == 0.0  # commanded so, or by its own watchdog
        assert drive.state is not DriveState.OPERATION_ENABLED
        judge = cycle.judge
        assert judge is not None
        return Outcome(
            cycle.cycles,
            experiment.rig.link_statistics(),
            Counter(experiment.faulty_buses[""].counts),
            accounted.most,
            0.5 * COUNT * (watched.variation + abs(watched.last)) + 1e-12,
            judge.least[0],
            cycle.ledgers[0].summary().energy_in,
            heard,
            error,
        )


class Overbelief:
    """Compares what the ledger believes with the plant's truth after every position that arrived."""

    def __init__(self, experiment: Experiment, inner: Controller) -> None:
        assert experiment.far_side is not None
        self.inner = inner
        self.cycle, self.drive, self.most = experiment.cycle, experiment.far_side.drives[0], 0.0

    def look(self, _cycles: int) -> None:
        if self.cycle.rig.drives[0].policy.missed:
            return
        account = self.cycle.ledgers[0].summary()
        true = -self.drive.truth().energy.motor
        # of what lost samples leave possible, the middle is booked
        within = getattr(self.inner, "energy_resolution", 0.0)
        self.most = max(self.most, account.energy_in - account.energy_out - within - true)


def assert_ledger_bound_kept(outcome: Outcome) -> None:
    assert outcome.energy_in > 0.05  # there was contact
    assert outcome.overbelieved <= outcome.encoder_bound
    assert outcome.encoder_bound < 1e-3 * outcome.energy_in


@pytest.mark.slow_but("guarded-0.01")
@pytest.mark.parametrize("drop", [0.0, 0.01, 0.1])
@pytest.mark.parametrize("passivity", [GUARDED, PAPER], ids=["guarded", "internal_dissipation"])
def test_lost_frames_are_counted_to_the_frame_and_the_ledger_bound_is_kept(passivity: str, drop: float) -> None:
    within = "during: [{begin: 0.1 s, duration: 0.8 s}]"
    seen = disturbed(f"simulation.bus={{drop: {drop}, delay: 1 us, {within}}}", passivity, cycles=1000)
    assert seen.error is None
    assert seen.cycles in (1000, 1003)
    lost = {direction: sum(n for (_, to, _), n in seen.struck.items() if to == direction) for direction in DIRECTIONS}
    on_the_bus = Counter(is_from_drive(message) for message in seen.heard)
    assert seen.link["sent"] == on_the_bus[False] + lost["to_drive"]
    assert seen.link["received"] == on_the_bus[True] - lost["to_master"]
    unanswered = seen.struck["drop", "to_drive", 0x080] + seen.struck["drop", "to_master", 0x181]
    assert seen.link["missed_tpdos"] == unanswered
    syncs = seen.cycles
    assert seen.link["success_rate"] == pytest.approx(1.0 - seen.link["missed_tpdos"] / syncs)
    assert bool(unanswered) == bool(drop)
    assert {seen.link[name] for name in ("late", "duplicate", "short", "foreign", "send_failures")} == {0}
    assert_ledger_bound_kept(seen)
    assert seen.least == 0.0  # and the user never got more than he gave


DIRECTIONS = ("to_drive", "to_master")


def is_from_drive(message: can.Message) -> bool:
    return message.arbitration_id in (0x081, 0x181, 0x581, 0x701)


DISTURBANCES = [
    f"drop: 0.1, drop_burst: 3, {AFTER_THE_START}",
    f"reorder: 0.05, reorder_delay: 0.7 ms, {AFTER_THE_START}",
    f"jitter: 200 us, {AFTER_THE_START}",
    f"duplicate: 0.2, {AFTER_THE_START}",
    "freeze: [{begin: 0.2 s, duration: 10 ms, every: 0.3 s}]",
    "stall: [{begin: 0.2 s, duration: 10 ms, every: 0.3 s}]",
    f"drop: 0.02, jitter: 200 us, duplicate: 0.05, reorder: 0.02, refuse: 0.002, foreign_rate: 300, {AFTER_THE_START}",
    f"jitter: 100 us, foreign_rate: 300 Hz, wire_time: true, {AFTER_THE_START}",
]


@pytest.mark.slow_but("internal_dissipation-stall*")
@pytest.mark.parametrize("bus", DISTURBANCES)
@pytest.mark.parametrize("passivity", [GUARDED, PAPER], ids=["guarded", "internal_dissipation"])
def test_in_every_disturbance_the_ledger_never_believes_too_much(passivity: str, bus: str) -> None:
    seen = disturbed(f"simulation.bus={{{bus}}}", passivity, QUICK, cycles=1000)
    assert seen.error is None or "duplicate" in bus
    assert isinstance(seen.error, TpdoContradictedError | None)  # a repeated TPDO that answers the next SYNC as well
    assert_ledger_bound_kept(seen)


@pytest.mark.slow
def test_every_fault_appears_in_its_own_count_of_the_link() -> None:
    only = "ids: [0x181], direction: to_master"
    ideal = disturbed("simulation.bus={delay: 1 us}", cycles=400).link
    for bus, effect, counts in (
        (f"duplicate: 0.1, {only}", "duplicate", {"late": 1, "received": 1}),
        (f"truncate: 0.1, {only}", "truncate", {"short": 1, "missed_tpdos": 1}),
        (f"drop: 0.1, {only}", "drop", {"missed_tpdos": 1, "received": -1}),
        ("foreign_rate: 500", "foreign", {"foreign": 1, "received": 1}),
        ("refuse: 0.01, ids: [0x080]", "refuse", {"send_failures": 1}),
    ):
        seen = disturbed(f"simulation.bus={{{bus}, {WITHIN}}}", cycles=400)
        [struck] = {n for (name, _, _), n in seen.struck.items() if name == effect}
        changed = {name: seen.link[name] - ideal[name] for name in ideal if name != "success_rate"}
        expected = {name: sign * struck for name, sign in counts.items()}
        assert {name: n for name, n in changed.items() if n} == expected, bus
        assert struck > 0


def test_a_stall_skips_its_syncs_and_never_bursts() -> None:
    seen = disturbed("simulation.bus={stall: [{begin: 0.2 s, duration: 50 ms}]}", cycles=400)
    assert seen.link["skipped_syncs"] == 50
    times = [message.timestamp for message in seen.heard if message.arbitration_id == 0x080]
    assert min(after - before for before, after in itertools.pairwise(times)) >= 0.999e-3


@pytest.mark.slow_but("drop*0x181*", "truncate*", "stall*", "bus_off*")
@pytest.mark.parametrize(
    ("bus", "error", "reason"),
    [
        ("drop: 1, ids: [0x181], during: [{begin: 0.2, duration: 9}]", LinkError, "TPDO_LOST"),
        ("drop: 1, ids: [0x701], during: [{begin: 0.2, duration: 9}]", LinkError, "HEARTBEAT_LOST"),
        ("drop: 1, ids: [0x77E], during: [{begin: 0.2, duration: 9}]", DriveFaultError, "EMCY 0x8130"),
        ("truncate: 1, ids: [0x201], during: [{begin: 0.2, duration: 9}]", DriveFaultError, "EMCY 0x8210"),
        ("freeze: [{begin: 0.2, duration: 60 ms}]", LinkError, "TPDO_LOST"),
        ("stall: [{begin: 0.2, duration: 0.5}]", SyncsSkippedError, "it stood still for 0.5.*8130.*SYNCS_SKIPPED"),
        ("bus_off: [{begin: 0.2, duration: 0.05}]", LinkError, "SEND_FAILED"),
        ("refuse: 1, ids: [0x201], during: [{begin: 0.2, duration: 9}]", LinkError, "SEND_FAILED"),
        ("foreign_rate: 200, foreign_ids: [0x081], during: [{begin: 0.2, duration: 9}]", DriveFaultError, "EMERGENCY"),
    ],
)
def test_faults_beyond_the_policy_stop_the_run_with_their_reason(bus: str, error: type[RigError], reason: str) -> None:
    seen = disturbed(f"simulation.bus={{{bus}}}", GUARDED, QUICK, cycles=1000)
    assert isinstance(seen.error, error)
    assert re.search(reason, str(seen.error))
    assert 50 < seen.cycles < 400
    rpdos = [int.from_bytes(m.data[2:4], "little", signed=True) for m in seen.heard if m.arbitration_id == 0x201]
    assert min(rpdos) < -100
    if "TPDO_LOST" in reason or "HEARTBEAT" in reason or "EM" in reason:  # the drive could still be commanded
        assert set(rpdos[-2:]) == {0}


@pytest.mark.slow_but("0")
@pytest.mark.parametrize("seed", range(6))
def test_wrong_bits_never_end_in_an_unknown_error_or_in_torque_beyond_the_limit(seed: int) -> None:
    bus = f"corrupt: 0.02, truncate: 0.002, duplicate: 0.02, {AFTER_THE_START}"
    scene = load_scene(DEMO, [*IN_AND_OUT, GUARDED, QUICK, f"simulation.bus={{{bus}}}", f"simulation.seed={seed}"])
    with build(scene, "free") as experiment:
        assert experiment.far_side is not None
        [drive] = experiment.far_side.drives
        torques = []
        with suppress(RigError):
            run(experiment.cycle, 800, progress=lambda _: torques.append(drive.torque))
        assert 0.0 < max(map(abs, torques)) <= 20.0  # 0x6072 of the drive holds against a turned bit
        assert drive.torque == 0.0
        assert drive.state is not DriveState.OPERATION_ENABLED


@pytest.mark.slow
def test_an_effect_that_does_nothing_leaves_every_frame_at_its_instant(tmp_path: Path) -> None:
    """The wrapper itself adds nothing: not a nanosecond, not a frame."""
    logs = []
    for name, overrides in (("ideal", []), ("wrapped", ["simulation.bus={drop: 1, ids: [0x7FF]}"])):
        with build(load_scene(DEMO, overrides), "free", bus_log=tmp_path / name) as experiment:
            run(experiment.cycle, 300)
        logs.append((tmp_path / name).read_bytes())
    assert logs[0] == logs[1]


# --- real time ----------------------------------------------------------------------------------------------------


def test_a_drive_on_its_own_hears_and_answers_through_its_faulty_bus() -> None:
    """As `canhaptic drive` does it: the faults are on the drive's side, the master's connection is bare."""
    bus = "bus={delay: 1 ms, jitter: 1 ms, duplicate: 0.3, stall: [{duration: 1}], refuse: 1, direction: to_master}"
    shared = ["bus.channel=drive-alone", "bus.rate=50 Hz", "bus.heartbeat_timeout=5 s"]
    far, master = load_scene(DEMO, [*shared, f"simulation.{bus}"]), load_scene(DEMO, [*shared, "simulation=null"])
    stop = drive_command.StopSignal()  # type: ignore[attr-defined]
    with virtual_bus("drive-alone") as bare:
        faulty = with_effects(bare, far, "drive")
        assert faulty is not None
        faulty.use(drive_command.WallClock(spin_margin=0.0))  # type: ignore[attr-defined]
        group = build_far_end(far, None, faulty)[0]
        thread = threading.Thread(target=drive_command._live, args=([(faulty, group)], 20.0, stop))
        thread.start()
        try:
            with build(master) as experiment:
                with suppress(LinkError, DriveFaultError):  # a busy machine may end it
                    run(experiment.cycle, cycles=10)
                link = experiment.rig.link_statistics()
        finally:
            stop.numbers.append(2)
            thread.join(5.0)
            faulty.shutdown()
    assert link["duplicate"] + link["late"] > 0
    assert faulty.totals().keys() == {"duplicate"}  # stalls, and frames refused, are the master's
    assert faulty.totals()["duplicate"].keys() == {"to_master"}
