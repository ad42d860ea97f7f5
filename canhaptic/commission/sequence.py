"""The steps in their order; findings before a fault are kept."""

from typing import Final

from canhaptic.commission.find_drives import identify
from canhaptic.commission.hand_motion import STANDSTILL, move_by_hand, stand_still
from canhaptic.commission.session import Session
from canhaptic.commission.torque_tests import identify_dynamics, pulse, time_the_read_back
from canhaptic.commission.watchdog import pull_the_master, time_the_cycle
from canhaptic.errors import InputError

REQUIRED: Final = (STANDSTILL, "torque sign", "moving mass", "mass on a shaft", "torque lag", "watchdog")
"""What must have been verified of every axis before its scene is one to run."""


def commission(session: Session, timing_duration: float) -> None:
    """Walk every step that the person agrees to; the findings are in `session.report`.

    Args:
        session: Rig, dialogue and limits.
        timing_duration: Duration of the timed run at zero torque [s].

    Raises:
        RigError: Drive or link failed; torque is zero, every drive that answers is disabled.
        InputError: The scene joins its axes in one simulated mechanism.
    """
    if session.scene.mechanisms:
        raise InputError(
            f"{session.scene.source}: commissioning tries one axis after the other, and this simulated mechanism joins "
            "them; leave `mechanisms` out and give every axis a `simulation` of its own"
        )
    tell = session.dialogue.tell
    with session.rig_of(with_hand=False):
        if not _stands_still(session):
            return
    with session.rig_of(with_hand=True):
        tell("3 of 6: the encoder, moved by hand (zero torque)")
        for axis in range(len(session.axes)):
            if not session.stop_requested():
                move_by_hand(session, axis)
    with session.rig_of(with_hand=False):
        _with_torque(session)
        if session.stop_requested():
            return
        tell("5 of 6: the watchdog, by silence of the master (zero torque)")
        pull_the_master(session)
        if session.stop_requested():
            return
        tell(f"6 of 6: the cycle, for {timing_duration:g} s (zero torque)")
        time_the_cycle(session, timing_duration)


def _stands_still(session: Session) -> bool:
    """Return whether every drive is the one of the configuration, and is at rest at zero torque."""
    session.dialogue.tell("1 of 6: who is on the bus (no torque, nothing enabled)")
    identify(session)
    if session.report.failed or session.stop_requested():
        return False
    names = ", ".join(axis.parameters.name for axis in session.axes)
    asked = f"{names}: hands off, clear of the machine. Enable the drives at zero torque?"
    if not session.agreed(asked, STANDSTILL, [0]):
        return False
    session.dialogue.tell("2 of 6: standing still at zero torque")
    still = [not session.stop_requested() and stand_still(session, axis) for axis in range(len(session.axes))]
    return all(still) and not session.stop_requested()


def _with_torque(session: Session) -> None:
    session.dialogue.tell("4 of 6: first torque")
    for axis in range(len(session.axes)):
        if session.stop_requested():
            return
        rough_mass = pulse(session, axis)
        if rough_mass is not None and not session.stop_requested():
            identify_dynamics(session, axis, rough_mass)
    if not session.report.unfinished((), ()) and not session.stop_requested():
        time_the_read_back(session)
