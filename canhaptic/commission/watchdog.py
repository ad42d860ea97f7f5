"""Test of the drives' watchdogs by a silent master, and of the cycle's timing."""

from typing import Final

from canhaptic.canopen import objects as od
from canhaptic.commission.findings import StepVerdict
from canhaptic.commission.laws import NO_TORQUE, OpenLoop
from canhaptic.commission.session import Session
from canhaptic.drive.profile.power_states import TORQUE_FREE, drive_state
from canhaptic.errors import RigError, SdoError

_LOST: Final[tuple[str, ...]] = ("missed_tpdos", "late", "error_frames")
_LEAST_JITTER: Final = 0.01
_MARGIN: Final = 2.0
_SILENCES: Final = 3  # of the longest silence that the drives are configured to bear


def pull_the_master(session: Session) -> None:
    """Enable every drive at zero torque, fall silent, and check whether they leave OPERATION ENABLED by themselves.

    Raises:
        RigError: Drive or link failed otherwise than intended.
    """
    asked = "watchdog: the drives are enabled at zero torque, then the master falls silent. Now?"
    axes = range(len(session.axes))
    if not session.agreed(asked, "watchdog", axes, "a killed master may leave a torque on"):
        return
    rig = session.rig
    rig.start()
    try:
        silence = _SILENCES * rig.bus.master_silence_ns
        for link in rig.links:
            link.pump(link.clock.now() + silence)
        for axis in axes:
            _judge(session, axis)
    finally:
        _end(session)


def _judge(session: Session, axis: int) -> None:
    drive = session.drives[axis]
    limit = f"within {_SILENCES * session.rig.bus.master_silence_ns / 1e6:g} ms"
    try:
        state = drive_state(drive.sdo.read(od.STATUSWORD))
    except SdoError as error:
        session.found(axis, "watchdog", limit, "no answer", StepVerdict.FAILED, str(error))
        return
    stopped = state in TORQUE_FREE
    emergency = f", {drive.emergency}" if drive.emergency is not None else ""
    text = "a killed master leaves its torque on: set axes[].watchdog, 0x1016 and 0x6007, or a relay"
    found = f"{state.value}{emergency}"
    session.judged(axis, "watchdog", limit, found, good=stopped, text=text, otherwise=StepVerdict.FAILED)


def _end(session: Session) -> None:
    """Disable the drives that are still enabled, and reset the faults that this test caused, if the person agrees."""
    try:
        session.rig.stop(ramp=False)
    except RigError as error:
        session.dialogue.tell(f"  {error}")
    if session.dialogue.confirm("watchdog: reset the faults that this test has made (no drive is enabled by it)?"):
        session.rig.reset_faults()


def time_the_cycle(session: Session, seconds: float) -> None:
    """Run the whole rig at zero torque and report frames and, at real pace, times.

    Raises:
        RigError: Drive or link failed.
    """
    laws = [OpenLoop(NO_TORQUE) for _ in session.axes]
    before = session.rig.link_statistics()
    cycle = session.run(laws, session.cycles(seconds))
    statistics = session.rig.link_statistics()
    lost = {"skipped_syncs": statistics["skipped_syncs"]}  # counted from the start of a run, the others of the link
    lost.update((name, statistics[name] - before[name]) for name in _LOST)
    clean = not any(lost.values())
    found = f"{cycle.cycles} cycles, " + ("no frame lost" if clean else _words(lost))
    text = "see `canhaptic check` (bus load, host) and `canhaptic preflight`; try bus.realtime"
    session.judged(0, "cycle", f"{1.0 / session.sample_time:g} Hz", found, good=clean, text=text)
    _propose_jitter(session, cycle.timing["wakeup_lateness"].maximum * 1e-9 / session.sample_time)
    if session.experiment.pace == "free":
        session.found(
            0, "timing", "", "lock-step", StepVerdict.UNKNOWN, "simulated drives without a clock of their own"
        )
        return
    for name, histogram in cycle.timing.items():
        p50, p99 = histogram.quantile(0.5) * 1e6, histogram.quantile(0.99) * 1e6
        found = f"p50 {p50:.0f} us, p99 {p99:.0f} us"
        session.found(0, name.replace("_", " "), "", found, StepVerdict.MEASURED)


def _propose_jitter(session: Session, latest: float) -> None:
    """Propose the jitter of a hold, as a part of the sample time.

    Args:
        session: Session with its axes.
        latest: Largest lateness of a SYNC [sample times]; 0 where time is virtual.
    """
    for axis, scene in enumerate(session.axes):
        jitter = max(_LEAST_JITTER, _MARGIN * latest)
        if session.experiment.pace == "free":
            jitter = scene.loop.sync_jitter or _LEAST_JITTER
        comment = f"at least 1 %, or {_MARGIN:g} times the largest lateness of a SYNC in this run"
        session.propose(axis, "passivity.sync_jitter", jitter, "1", comment)


def _words(counts: dict[str, float]) -> str:
    return ", ".join(f"{name.replace('_', ' ')} {count:g}" for name, count in counts.items() if count)
