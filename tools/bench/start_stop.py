"""How long do start, stop and fault reset of a rig take beyond what the drive itself needs?

In real time, one axis at 1 kHz and three at 500 Hz. The simulated drive answers an SDO at once and follows a
controlword at the next SYNC. What it needs itself is subtracted: a start is confirmed by two heartbeats of the drive,
one as soon as it is configured to send them and one that says OPERATIONAL, each up to a period after what it confirms;
and the drive that enables slowly (brake, commutation) takes 0.2 s for it. The whole start is shown as well. An
operator's stop takes the torque down along its ramp of 20 ms, which is part of the time. Worst of the repeats.
"""

from collections.abc import Callable, Sequence
from time import perf_counter

from canhaptic.errors import RigError
from canhaptic.scene.build import Experiment, build
from canhaptic.scene.buses import can_bus
from canhaptic.sim.drive.profile.state_machine import DriveState
from tools.bench.demo import demo_of
from tools.bench.report import Row, publish

RATES = {1: 1000, 3: 500}  # [Hz] that the worst cycle of so many axes allows at 1 Mbit/s
REPEATS = 5
CYCLES = 20
MOST, MOST_RESET = 0.1, 0.05  # [s]
SLOW = 0.2  # [s]


def timed(action: Callable[[], object]) -> float:
    """Returns how long an action takes [s]."""
    begin = perf_counter()
    action()
    return perf_counter() - begin


def drives_are(experiment: Experiment, state: DriveState) -> None:
    """Makes sure that it was done: what the drives themselves say."""
    assert experiment.far_side is not None
    for drive in experiment.far_side.drives:
        if drive.state is not state:
            raise SystemExit(f"node {drive.node_id} is in {drive.state.name}, expected {state.name}")


def start_and_stop(axes: int, enable_delay: float, *, ramp: bool) -> tuple[float, float]:
    """Returns the times of a start and of a stop [s]."""
    with build(demo_of(axes, RATES[axes], enable_delay), "real") as experiment:
        rig = experiment.rig
        start = timed(rig.start)
        drives_are(experiment, DriveState.OPERATION_ENABLED)
        for _ in range(CYCLES):
            experiment.cycle.step()
        stop = timed(lambda: rig.stop(ramp=ramp))
        drives_are(experiment, DriveState.SWITCH_ON_DISABLED)
    return start, stop


def fault_reset(axes: int) -> float:
    """Returns the time of the reset of a fault of every drive [s]."""
    with build(demo_of(axes, RATES[axes]), "real") as experiment:
        experiment.rig.start()
        assert experiment.far_side is not None
        for drive in experiment.far_side.drives:
            drive.inject_fault()
        try:
            for _ in range(CYCLES):
                experiment.cycle.step()
        except RigError:
            pass
        drives_are(experiment, DriveState.FAULT)
        reset = timed(experiment.rig.reset_faults)
        drives_are(experiment, DriveState.SWITCH_ON_DISABLED)
    return reset


def rows_for(axes: int) -> list[Row]:
    """Returns the figures of one number of axes."""
    name = f"{axes} axis" if axes == 1 else f"{axes} axes"
    heartbeats = 2 * can_bus(demo_of(axes, RATES[axes]).bus).heartbeat_period
    plain = [start_and_stop(axes, 0.0, ramp=True) for _ in range(REPEATS)]
    at_once = [start_and_stop(axes, 0.0, ramp=False) for _ in range(REPEATS)]
    slow = [start_and_stop(axes, SLOW, ramp=True) for _ in range(REPEATS)]
    resets = [fault_reset(axes) for _ in range(REPEATS)]
    return [
        Row(f"{name}: whole start", 1e3 * max(start for start, _ in plain), "ms"),
        _row(f"{name}: start less two heartbeats", [start - heartbeats for start, _ in plain], MOST),
        _row(f"{name}: start of slow drives less their own time", [s - heartbeats - SLOW for s, _ in slow], MOST),
        _row(f"{name}: stop by the operator, ramp of 20 ms included", [stop for _, stop in plain], MOST),
        _row(f"{name}: stop at once", [stop for _, stop in at_once], MOST),
        _row(f"{name}: fault reset", resets, MOST_RESET),
    ]


def _row(name: str, times: Sequence[float], most: float) -> Row:
    worst = max(times)
    return Row(name, 1e3 * worst, "ms", target=f"< {1e3 * most:g}", met=worst < most)


def main() -> None:
    """Measures and publishes."""
    publish("start_stop", [row for axes in RATES for row in rows_for(axes)], ["canhaptic", "python-can"])


if __name__ == "__main__":
    main()
