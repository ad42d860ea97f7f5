"""Verification of the torque scale, before more than a few per mille of the drive's rated torque are sent.

A rated torque from a name plate, or a forgotten gear, scales every torque by one wrong ratio, `torque_limit`
included, and no certificate notices: the reference must come from outside the drive. Either the moved mass is known,
and doublets of a torque measure it, or the drive lifts a known weight on an arm, or it pushes against a spring balance.
"""

import math
from functools import partial
from typing import Final

import numpy as np

from canhaptic.axis_units import effort_unit
from canhaptic.commission.mass_and_friction import SURE, estimate
from canhaptic.commission.session import OpenLoop, Session, StepVerdict, reversals
from canhaptic.commission.torque_tests import MASS_UNITS, Pulse, largest_torque, pulse
from canhaptic.scene.models import AxisScene

SCALE: Final = "torque scale"
"""Name of the step in the report."""
_TOLERANCE: Final = 0.1
_SHARP: Final = 0.05  # part of a mass that its standard deviations may take, and it still verifies a scale
_DOUBLETS: Final = 32
_SHORTEST, _LONGEST = 4, 60  # cycles of their first part
_PART: Final = 0.4  # of travel and speed that they may use
_STEP: Final = 0.1  # [s] for which a rising torque keeps each value
_SEEN: Final = 20  # counts of motion of a weight that was lifted
_UNATTENDED: Final = 10  # steps after which a simulated balance is read


class RisingTorque(OpenLoop):
    """A torque that rises count by count; with `lifts` it falls again once the axis has moved, until the axis returns.

    Attributes:
        up: Torque at which the axis was lifted, 0 before [N or N*m].
        down: Torque at which the axis returned, 0 before [N or N*m].
    """

    def __init__(
        self, quantum: float, most: float, holds: int, travel: float, largest_step: float, seen: float, *, lifts: bool
    ) -> None:
        self._quantum, self._most, self._holds, self._seen, self._lifts = quantum, most, holds, seen, lifts
        super().__init__((), travel, largest_step)

    def reset(self) -> None:
        """Clear the record, and begin with one count."""
        super().reset()
        self.up = self.down = self._present = 0.0

    @property
    def has_ended(self) -> bool:
        """Whether the last torque was played."""
        is_over = self._lifts and not self.up and self._present > self._most
        return bool(self.tripped or self.down or is_over)

    def next_torque(self) -> float:
        """Torque of the next hold [N or N*m]."""
        moved = self.positions[-1] - self.positions[0]
        if self._lifts and not self.up and moved >= self._seen:
            self.up = self._present
        elif self.up and max(self.positions) - self.positions[-1] >= self._seen:
            self.down = max(self._present, self._quantum)
        if (len(self.positions) - 1) % self._holds == 0:
            self._present += -self._quantum if self.up else self._quantum
        if self.has_ended:
            return 0.0
        return max(0.0, min(self._present, self._most))


def verified_axes(session: Session) -> dict[int, Pulse]:
    """Send the first torque to every axis and verify its scale; return the first pulses of the axes that agree.

    Raises:
        RigError: Drive or link failed.
    """
    firsts: dict[int, Pulse] = {}
    means: dict[int, str] = {}
    with session.rig_of(with_hand=False):
        for axis, scene in enumerate(session.axes):
            first = None if session.stop_requested() else pulse(session, axis)
            if first is None:
                continue
            question = f"{scene.parameters.name}: how is the scale of the torque verified?"
            simulation = scene.simulation  # its mass is known where nothing else moves with it
            truth = "mass" if simulation is None or not simulation.effects else "balance"
            firsts[axis] = first
            means[axis] = session.dialogue.choose(question, ("weight", "balance", "mass", "no"), truth)
            if means[axis] == "mass":
                _judge(session, axis, "mass", _by_mass(session, axis, first))
    for axis, word in means.items():
        if word == "no":
            text = "no further torque: a wrong scale also makes torque_limit wrong"
            session.found(axis, SCALE, "1", "not compared", StepVerdict.UNKNOWN, text)
        elif word != "mass" and not session.stop_requested():
            hand = partial(_balance, session) if word == "balance" else None
            with session.rig_of(with_hand=True, hand=hand):
                _judge(session, axis, word, _by_force(session, axis, word))
    return {axis: first for axis, first in firsts.items() if axis in session.verified}


def _balance(session: Session, axis: AxisScene) -> object:
    """Hand at a simulated handle that holds it as a spring balance does."""
    simulation = axis.simulation
    if simulation is None or simulation.user is None:
        return None
    most = axis.parameters.rated_torque or axis.parameters.torque_limit
    stiffness = 100.0 * session.limits.torque * most / session.limits.travel
    damping = math.sqrt(stiffness * simulation.plant.mass)
    rest = {"rest": simulation.plant.initial_position, "motion": None, "push": 0.0}
    return simulation.user.model_copy(update={"stiffness": stiffness, "damping": damping, **rest})


def _by_mass(session: Session, axis: int, first: Pulse) -> float | None:
    """Ratio of the true torque to the assumed one, by the known mass and doublets; None where it stays unclear.

    They begin with the torque of the first pulse that was seen, which is raised only while the axis moved too little.
    """
    scene = session.axes[axis]
    name, simulation = scene.parameters.name, scene.simulation
    truth = None if simulation is None or simulation.effects else simulation.plant.mass
    question = f"{name}: moving mass, from a scale or a drawing?"
    known = session.dialogue.number(question, MASS_UNITS[scene.parameters.unit], truth)
    torque, most = first.torque, largest_torque(session, axis)
    sent = f"{session.shown(axis, torque)}, at most {session.shown(axis, most)}"
    asked = f"{name}: hands off. Doublets of {sent} while it moves too little, now?"
    if not known or known <= 0.0 or not session.agreed(asked, SCALE, [axis]):
        return None
    while True:
        session.coast(axis)
        acceleration = torque / first.mass  # an estimate, so that a part of the limits is used
        wanted = math.sqrt(_PART * session.limits.travel / acceleration), _PART * session.limits.speed / acceleration
        longest = max(_SHORTEST, min(_LONGEST, session.cycles(min(wanted))))
        torques = reversals(torque, longest, _DOUBLETS)
        law = session.play(axis, torques, len(torques) + 2)
        if law.tripped or session.stop_requested():
            return None
        positions = np.array(law.positions) / session.encoder_ratios[axis]  # a wrong encoder is not a wrong mass
        found = estimate(positions, np.array(law.applied), session.sample_time, longest)
        if found is not None and 0.0 < SURE * found.mass_error <= _SHARP * found.mass:
            return known / found.mass
        if torque >= most:
            return None
        torque = min(most, 2.0 * torque)


def _by_force(session: Session, axis: int, means: str) -> float | None:
    """The same by a weight that is lifted, or by a spring balance that holds the handle; None where it is unclear."""
    parameters = session.axes[axis].parameters
    name, unit, most = parameters.name, effort_unit(parameters.unit), parameters.torque_limit
    lifts, quantum, known = means == "weight", session.quanta[axis], None
    if lifts:
        asked = f"{name}: torque of the weight (mass, times 9.81 m/s^2, times arm)?"
        known = session.dialogue.number(asked, unit, None)
    held = "the weight on its support, so that + lifts it" if lifts else "the handle held at rest by a spring balance"
    range_of = f"from {session.shown(axis, quantum)} to {session.shown(axis, most)}"
    asked = f"{name}: {held}. A torque that rises {range_of}, now?"
    if (lifts and not known) or not session.agreed(asked, SCALE, [axis]):
        return None
    holds, limits = session.cycles(_STEP), session.limits
    seen = _SEEN / parameters.counts_per_unit
    law = RisingTorque(quantum, most, holds, limits.travel, limits.speed * session.sample_time, seen, lifts=lifts)
    asked, steps = f"{name}: press Enter when you can read the balance", _UNATTENDED * holds
    pressed = None if lifts else session.dialogue.until_ready(asked, steps)
    cycles = 2 * holds * (2 + math.ceil(most / quantum))
    session.run_alone(axis, law, cycles, lambda: law.has_ended or (pressed is not None and pressed()))
    sent = 0.5 * (law.up + law.down) if law.up and law.down else 0.0
    if not lifts:
        sent = law.applied[-1] if law.applied and not law.tripped else 0.0
        known = session.dialogue.number(f"{name}: reading of the balance, times its arm?", unit, session.effort(axis))
    if not sent or not known or session.stop_requested():
        session.dialogue.tell(f"  {name}: {SCALE}: {law.tripped or 'nothing was lifted, or read'}")
        return None
    return abs(known / sent)


def _judge(session: Session, axis: int, means: str, ratio: float | None) -> None:
    """Report a ratio of true to assumed torque, and propose the resulting values."""
    parameters = session.axes[axis].parameters
    if ratio is None:
        text = "unclear; use another method, or raise --torque or --travel"
        return session.found(axis, SCALE, "1", "not compared", StepVerdict.UNKNOWN, text)
    same = abs(ratio - 1.0) <= _TOLERANCE
    text = "every torque is wrong by this ratio, torque_limit too; correct it, then commission again"
    session.judged(axis, SCALE, "1", f"{ratio:.4g}", good=same, text=text)
    key = "transmission" if parameters.rated_torque is None else "rated_torque"
    if same:
        session.verified.add(axis)
        session.propose(axis, "torque_verified", means, comment="the scale of the torque agrees")
        return session.propose(axis, key, None, comment=f"agrees, by {means}")
    unit = effort_unit(parameters.unit) if key == "rated_torque" else ""
    session.propose(axis, key, getattr(parameters, key) * ratio, unit, f"by {means}")
