"""The axis at zero torque: whether it stays at rest, and whether the encoder counts as the configuration states."""

from typing import Final

from canhaptic.commission.findings import StepVerdict
from canhaptic.commission.laws import NO_TORQUE
from canhaptic.commission.session import Session

STANDSTILL: Final = "standstill at zero torque"
"""What the report calls the step."""
_WATCHED: Final = 1.0  # [s] that an axis must stand still
_UNATTENDED: Final = 0.4  # [s] of the simulated hand's motion
_LONGEST: Final = 120.0  # [s] that a person may take
_FEWEST_COUNTS: Final = 200  # half a per cent
_TOLERANCE: Final = 0.02  # a hand with a ruler
_DRIFT: Final = 0.25  # part of the travel that an axis without torque may move by itself


def stand_still(session: Session, axis: int) -> bool:
    """Enable the drive with zero torque; return False when the axis moves by itself.

    Raises:
        RigError: Drive or link failed.
    """
    name, unit = session.axes[axis].parameters.name, session.axes[axis].parameters.unit
    law = session.play(axis, NO_TORQUE, session.cycles(_WATCHED))
    if not law.positions:  # the operator stopped it
        session.not_tried(STANDSTILL, [axis])
        return False
    drift = abs(law.positions[-1] - law.positions[0])
    swing = max(law.positions) - min(law.positions)
    still = drift <= _DRIFT * session.limits.travel
    text = f"{name} moves without torque: weight, a wrong offset of the drive, or somebody pushes"
    found = f"{drift:.3g} {unit}, noise {swing:.3g}"
    session.judged(axis, STANDSTILL, "", found, good=still, text=text, otherwise=StepVerdict.FAILED)
    return still


def move_by_hand(session: Session, axis: int) -> None:
    """Compare a distance moved by hand with the encoder's; the drive holds zero torque meanwhile.

    Raises:
        RigError: Drive or link failed.
    """
    parameters = session.axes[axis].parameters
    unit = parameters.unit
    begin: list[float] = []
    ready = session.dialogue.until_ready(
        f"{parameters.name}: move the handle by a distance that you can measure, in the direction that shall count as "
        "positive; hold it there and press Enter",
        session.cycles(_UNATTENDED),
    )

    def done() -> bool:
        truth = session.truth(axis)
        if truth is not None and not begin:
            begin.append(truth)
        return ready()

    session.truths = ()
    law = session.play(axis, NO_TORQUE, session.cycles(_LONGEST), done)
    if not law.positions:
        session.not_tried("encoder", [axis])
        return
    truth = session.truth(axis)
    moved = None if truth is None or not begin else truth - begin[0]
    measured = law.positions[-1] - law.positions[0]
    stated = session.dialogue.number(f"{parameters.name}: how far was it, with its sign?", unit, moved)
    counts = abs(measured) * parameters.counts_per_unit
    if not stated or counts < _FEWEST_COUNTS:
        text = f"the encoder moved by {counts:.0f} counts, at least {_FEWEST_COUNTS} and a measured distance are needed"
        session.found(axis, "encoder", "", f"{measured:.4g} {unit}", StepVerdict.UNKNOWN, text)
        return
    session.encoder_ratios[axis] = abs(measured / stated)
    _judge(session, axis, measured / stated)


def _judge(session: Session, axis: int, ratio: float) -> None:
    parameters = session.axes[axis].parameters
    right = ratio > 0.0
    direction = parameters.direction if right else -parameters.direction
    text = "the encoder counts the other way"
    session.judged(axis, "encoder direction", str(parameters.direction), str(direction), good=right, text=text)
    if not right:
        session.propose(axis, "direction", direction)
    counts = parameters.counts_per_unit * abs(ratio)
    same = abs(abs(ratio) - 1.0) <= _TOLERANCE
    text = f"every position is wrong by {abs(ratio):.4g}; gear, counts per turn or 0x608F"
    unit = f"count/{parameters.unit}"
    configured, found = f"{parameters.counts_per_unit:g} {unit}", f"{counts:.6g} {unit}"
    session.judged(axis, "encoder counts", configured, found, good=same, text=text)
    text = "agrees with a distance moved by hand" if same else "by a distance moved by hand; round it to the data"
    session.propose(axis, "counts_per_unit", None if same else counts, unit, text)
