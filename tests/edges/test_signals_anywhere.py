"""One, two, three and ten signals at every look at the clock of a short run: each leaves the drive without torque."""

import signal
from itertools import count

import pytest

from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.passivity import LoopProperties, build_controller
from canhaptic.control.ports import axis_ports
from canhaptic.cycle import Cycle, run
from canhaptic.drive.clock import VirtualClock
from canhaptic.host.stop_signal import StopSignal
from canhaptic.sim.drive.profile.state_machine import DriveState
from tests.drive.drive_bench import Bench, axis, make_bench

CYCLES = 12
SYNC, RPDO = 0x80, 0x205


class Looks:
    """Raises signals at chosen looks at the clock, and counts them."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.places: range = range(0)
        self.seen, self.first_sync = 0, -1
        self.bench: Bench | None = None
        now = VirtualClock.now

        def look(clock: VirtualClock) -> int:
            self.seen += 1
            if self.seen in self.places and self.bench is not None:
                if self.first_sync < 0:
                    self.first_sync = len(self.bench.sent(SYNC))
                signal.raise_signal(signal.SIGHUP)
            return now(clock)

        patch.setattr(VirtualClock, "now", look)

    def attempt(self, places: range) -> tuple[Bench, Cycle, StopSignal]:
        """Runs into a wall, with a signal at each of these looks; a run ends by itself, or is ended."""
        bench = make_bench([axis()], bus={"stop_ramp": 1e-3})
        wall = SpringDamperWall(stiffness=500.0, damping=0.0, position=0.0, side="above")
        loop = LoopProperties(sample_time=1e-3, torque_limit=8.0, torque_quantum=0.01)
        cycle = Cycle(bench.rig, axis_ports([build_controller(wall, "unprotected", None, loop)]))
        self.places, self.seen, self.first_sync, self.bench = places, 0, -1, bench
        with StopSignal() as stop:
            run(cycle, CYCLES, stop.requested)
        self.places = range(0)
        return bench, cycle, stop


@pytest.fixture
def looks(monkeypatch: pytest.MonkeyPatch) -> Looks:
    return Looks(monkeypatch)


def all_places(looks: Looks) -> int:
    """Return the looks at the clock in a whole run; without a signal it pushes, and ends disabled."""
    bench, cycle, stop = looks.attempt(range(0))
    assert min(bench.torques_sent()) < 0
    assert (cycle.cycles >= CYCLES, stop.exit_status) == (True, 0)
    bench.close()
    return looks.seen


def assert_stopped(looks: Looks, places: range, cycles_of_a_run: int) -> int:
    """Check what signals at these looks leave; return the SYNCs until only zero is sent."""
    bench, cycle, stop = looks.attempt(places)
    try:
        assert stop.exit_status == 128 + signal.SIGHUP
        assert bench.drives[0].torque == 0.0, places
        assert bench.drives[0].state is not DriveState.OPERATION_ENABLED, places
        assert not bench.sent(RPDO) or bench.torques_sent()[-1] == 0
        assert cycle.cycles <= cycles_of_a_run
        return syncs_with_torque(bench, looks.first_sync)
    finally:
        bench.close()


def syncs_with_torque(bench: Bench, first_sync: int) -> int:
    """Return the SYNCs from the signal to the last torque that was sent."""
    syncs, last = 0, 0
    for _, can_id, data, is_rx in bench.frames:
        syncs += can_id == SYNC
        if can_id == RPDO and not is_rx and data[2:4] != b"\0\0":
            last = syncs
    return max(0, last - first_sync)


@pytest.mark.slow_but("97-1-2")
@pytest.mark.parametrize("signals", [1, 2, 3, 10])
@pytest.mark.parametrize(("step", "begin"), [(97, 1), *((5, n) for n in range(1, 6))])
def test_signals_at_every_instant_of_a_run_leave_no_torque_and_no_enabled_drive(looks: Looks, signals, step, begin):
    whole = all_places(looks)
    assert whole > 300
    longest = 0
    for first in range(begin, whole, step):
        longest = max(longest, assert_stopped(looks, range(first, first + signals), CYCLES + 3))  # of the stop
    print(f"{signals} signals at every {step}. of {whole} instants: at most {longest} SYNCs with torque")
    assert longest <= 2


def test_a_start_that_a_signal_ends_enables_no_drive(looks: Looks) -> None:
    for first in count(1, 61):
        bench, cycle, _ = looks.attempt(range(first, first + 1))
        enabling, is_over = b"\x0f\x00" in [data[:2] for data in bench.sent(RPDO)], cycle.cycles > 0
        bench.close()
        if enabling:  # it was commanded before the signal came
            assert first > 400
            return
        assert not is_over
