"""The sign of the torque, by pulses of random sign, from one count of 0x6071 upwards.

Other causes of motion (a hand, noise, cogging, an earlier pulse) do not depend on the random sign of the next pulse.
Where the torque acts against its sign, or not at all, a pulse moves the axis by its sign with a probability of at most
1/2. Each pulse that does multiplies the evidence by 2 p, each other one by 2 (1 - p), p = 0.9: the evidence for a wrong
sign is a supermartingale, and ever reaches 1 / a with a probability of at most a (Ville's inequality), however often
and with any torques pulses are repeated. Pulses that move the axis by less than a count say nothing.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from canhaptic.commission.session import LOST, OpenLoop, Session, StepVerdict, doublet, largest_torque

SIGN: Final = "torque sign"
"""Name of the step in the report."""
_PART: Final = 0.25  # of the travel of an axis that its first torques may use
_PULSE: Final = 0.04  # length of the first part of the first pulse [s]
_LONGEST: Final = 0.32
_COAST: Final = 2.0  # [s]
_SEEN: Final = 3.0  # counts by which a pulse moves the axis before it is repeated
_NUMBER: Final = 32  # pulses of a series
_SERIES: Final = 3  # with one torque and length
_TRIES: Final = 32  # single pulses and series
_WRONG: Final = 1e-6  # probability of a wrong sign
_AGREES: Final = 0.9  # share of the pulses that should agree


class Pulse(NamedTuple):
    """Pulses from which the sign of a torque is known."""

    mass: float  # first estimate, as the encoder has it [kg or kg*m^2]
    torque: float  # [N or N*m]


class _Evidence:
    """Motions of an axis along the signs of its pulses.

    Args:
        count: Distance of a count [m or rad].
    """

    def __init__(self, count: float) -> None:
        self._count, self._moves = count, list[float]()

    def add(self, moves: Sequence[float]) -> None:
        """Note motions along the signs of pulses [m or rad]."""
        self._moves += [move for move in moves if abs(move) > 0.5 * self._count]

    @property
    def moved(self) -> int:
        """Number of pulses that moved the axis."""
        return len(self._moves)

    @property
    def agreed(self) -> int:
        """Number of pulses that moved it along their sign."""
        return sum(move > 0.0 for move in self._moves)

    @property
    def is_sure(self) -> bool:
        """Whether one sign is certain."""
        agreed, against = self.agreed, self.moved - self.agreed
        ahead, behind = max(agreed, against), min(agreed, against)
        return float((2.0 * _AGREES) ** ahead * (2.0 - 2.0 * _AGREES) ** behind) >= 1.0 / _WRONG


def pulse(session: Session, axis: int) -> Pulse | None:
    """Find the sign of the torque; None: it stays unknown, or is wrong.

    A motor that turns against its encoder would make every wall pull in: it ends the commissioning of the axis.

    Raises:
        RigError: Drive or link failed.
    """
    parameters = session.axes[axis].parameters
    least, most = session.quanta[axis], max(session.quanta[axis], largest_torque(session, axis))
    pulses = f"Pulses from {session.shown(axis, least)} up to {session.shown(axis, most)} until it moves"
    asked = (
        f"{parameters.name}: let go of the handle. {pulses}, by at most {session.guard(axis, _PART).far}. Start now?"
    )
    if not session.agreed(asked, SIGN, [axis]):
        return None
    evidence = _Evidence(session.count(axis))
    law, torque, cycles, moves = _search(session, axis, evidence, least, most)
    if session.stop_requested() and not evidence.is_sure:
        session.not_tried(SIGN, [axis])
        return None
    if not evidence.is_sure:
        _report_unknown(session, axis, evidence, law, torque)
        return None
    moved = float(np.mean(moves))
    right, counts = 2 * evidence.agreed > evidence.moved, f"{evidence.agreed} of {evidence.moved} pulses"
    text = "torque and encoder disagree: every wall would pull in. Swap two motor phases, or change 0x607E"
    found = f"{moved:+.3g} {parameters.unit} at {session.shown(axis, torque)}, {counts}"
    session.judged(axis, SIGN, "+", found, good=right, text=text, fatal=True)
    mass = torque * (cycles * session.sample_time) ** 2 / (2.0 * max(moved, 0.1 * session.count(axis)))
    return Pulse(mass, torque) if right else None


def _report_unknown(session: Session, axis: int, evidence: _Evidence, law: OpenLoop, torque: float) -> None:
    """Say why no sign is certain."""
    found, text = "unclear", "moves against the torque as well: let go of the handle, remove what moves it"
    if law.tripped:
        found, text = "stopped", f"{law.tripped}; remove the cause, or raise --speed and --travel"
    elif not evidence.moved:
        found = f"no motion at {session.shown(axis, torque)}"
        text = "more friction than torque, a brake, or no current; raise --torque with care"
    session.found(axis, SIGN, "+", found, StepVerdict.UNKNOWN, text)


def _search(
    session: Session, axis: int, evidence: _Evidence, torque: float, most: float
) -> tuple[OpenLoop, float, int, list[float]]:
    """Pulse until a sign is certain; return the last record, its torque [N or N*m], cycles, and motions [m or rad].

    A pulse that does not move the axis is doubled, then lengthened; one that moves it too far is shortened.
    """
    random, cycles, longest = np.random.default_rng(1), session.cycles(_PULSE), session.cycles(_LONGEST)
    number, series = 1, 0  # of series with this torque and length
    for _ in range(_TRIES):
        signs = random.choice([-1.0, 1.0], number)
        session.coast(axis, _COAST)  # an axis that goes on swinging does not know the next sign either
        rest = [0.0] * (2 * cycles)
        torques = [part for sign in signs for part in [*doublet(float(sign) * torque, cycles), *rest]]
        law = session.play(axis, torques, len(torques) + 2 + session.scene.bus.delay, travels=_PART)
        moves = _moves(law, signs.tolist(), cycles)
        evidence.add(moves)
        seen = max(map(abs, moves), default=0.0) >= (_SEEN - 0.5) * session.count(axis)
        is_series = number > 1
        if evidence.is_sure or session.stop_requested():
            break
        if law.tripped:
            if law.tripped == LOST:
                continue
            if cycles == 1:
                break
            cycles = longest = cycles // 2
            number, series = 1, 0
        elif seen and series < _SERIES:
            number, series = _NUMBER, series + 1
        elif torque < most:
            torque, number, series = min(most, 2.0 * torque), 1, 0
        elif cycles < longest:
            cycles, number, series = min(longest, 2 * cycles), 1, 0
        elif is_series:
            break
        else:
            number = _NUMBER  # as small as its motions are
    return law, torque, cycles, moves


def _moves(law: OpenLoop, signs: list[float], cycles: int) -> list[float]:
    """Displacement over the first part of each pulse that was played, along its sign, from where its torque acted."""
    begin = next((k for k, torque in enumerate(law.applied) if torque), len(law.applied)) - 1
    starts = [(sign, begin + 6 * cycles * n) for n, sign in enumerate(signs)]
    at = law.positions
    return [sign * (at[start + cycles] - at[start]) for sign, start in starts if 0 <= start < len(at) - cycles]
