"""Test of the hold in which the torques of `guarded` act, made during a run by a random sign sequence in the torques.

Smooth motion in contact does not show a shift by one hold: to first order it looks like damping of the hand. So every
torque f in contact becomes f or f - 2 a towards zero, by a random sign d = 1 or -1: f - a + a d. A certificate of f
covers both, because it covers every smaller torque. With y_k the second difference of the positions p_k, p_(k-1),
p_(k-2), and d_k the sign of the torque that acts from p_k on,

    R(n) = sum over k of y_k d_(k-n).

**Early.** If the drive acts in the declared hold, R(0) is a sum of fair coin tosses, for every hand, friction, shaft
and fault, because y_k is past when d_k begins to act. So P(|R(0)| >= z s) <= 2 exp(-z^2 / 2) with
s^2 = sum (y_k d_k)^2: 7.5e-6 for z = 5 in each test. A drive that acts a hold early fails it.

**Late.** A mass that is pushed in the declared hold has R(1) = R(2) > 0 and R(3) = 0; pushed a hold later, it has
R(1) = 0 and R(2) = R(3) > 0. So the drive is found late if R(3) - R(1) is at least 5 of its own s, and |R(1)| at most a
quarter of R(3). This relies on the plant and not on causality alone. A lag of half a hold looks the same, so that the
test is made only if window and lag together are declared as at most a quarter of a hold.

**As declared.** The hold is found if R(1) - R(3) is at least 5 of its own s, and |R(3)| and |R(0)| are at most a
quarter of R(1). This relies on the plant too, and on the same condition. A later contradiction overrides it.

After such a finding no booked energy is certain: the resolution is all the energy that torques and motion could have
exchanged. The sums are tested each time the number of signs has doubled. After a lost sample or a skipped SYNC both
sequences restart.
"""

import random
from math import sqrt
from typing import Final

from canhaptic.control.balance import Certificate, EnergyBalance
from canhaptic.control.environments import Environment
from canhaptic.control.passivity import LoopProperties
from canhaptic.control.passivity.guarded import Guarded, GuardedParameters
from canhaptic.control.verdict import EARLY, FOUND, LATE, UNDECIDED

_SIGMAS: Final = 5.0
_FIRST_LOOK: Final = 64  # signs
_LATEST_PART: Final = 0.25  # window and lag, of a hold; and R(1), of R(3)
_NONE: Final = Certificate.NONE.value


class HoldWatch:
    """Test of the hold in which torques act: correlates the motion with the random signs of the torques.

    Args:
        delay: Declared whole holds between the computation of a torque and the hold in which it acts.
        tells_late: Whether to test for a late drive too; possible only if the declared lag is short.

    Attributes:
        found: How the drive contradicts the declared hold; empty: no contradiction so far.
        is_confirmed: Whether a test has found the declared hold.
        looks: Number of tests so far.
    """

    def __init__(self, delay: int, *, tells_late: bool) -> None:
        self._delay, self._tells_late = delay, tells_late
        self.found, self.looks, self.is_confirmed = "", 0, False
        self._count, self._next = 0, _FIRST_LOOK
        self._early = self._early_square = self._first = self._third = self._late_square = 0.0
        self.begin_anew()

    def begin_anew(self) -> None:
        """Restart the sequences of positions and signs after a lost sample, but keep the sums of the correlations."""
        self._signs = [0] * (self._delay + 3)  # newest first: of the torques computed one, two, ... samples ago
        self._before = self._last = 0.0
        self._positions = 0  # in a row

    def take(self, position: float, sign: int) -> None:
        """Add a position and the sign of the torque computed from it; test the drive when enough signs were added.

        Args:
            position: Position at a SYNC [m or rad].
            sign: 1 or -1 along positive torques; 0: this torque has none.
        """
        signs, delay = self._signs, self._delay
        signs.insert(0, sign)
        bend = position - 2.0 * self._last + self._before
        self._before, self._last = self._last, position
        self._positions += 1
        if self._positions > 2:
            early, first, third = bend * signs[delay], bend * signs[delay + 1], bend * signs[delay + 3]
            self._early += early
            self._early_square += early * early
            self._first += first
            self._third += third
            self._late_square += (third - first) * (third - first)
        signs.pop()
        if sign:
            self._count += 1
            if self._count == self._next:
                self._next *= 2
                self._look()

    def _look(self) -> None:
        self.looks += 1
        late, whole = self._third - self._first, abs(self._first) <= _LATEST_PART * self._third
        if self._early_square and abs(self._early) >= _SIGMAS * sqrt(self._early_square):
            self.found = self.found or EARLY
        elif self._tells_late and self._late_square and whole and late >= _SIGMAS * sqrt(self._late_square):
            self.found = self.found or LATE
        elif self._tells_late and self._late_square and -late >= _SIGMAS * sqrt(self._late_square):
            rest = max(abs(self._third), abs(self._early))
            self.is_confirmed = self.is_confirmed or rest <= _LATEST_PART * self._first


class DitheredGuarded(Guarded):
    """`guarded` with random steps in its torques in contact; certified until their test contradicts the declared hold.

    The signs follow from the first position, so that a log of the run recomputes and replays them.

    Args:
        environment: Environment to render.
        parameters: Parameters of `guarded`.
        loop: Properties of the loop.
        amplitude: Amplitude a of the random steps [N or N*m].
    """

    def __init__(
        self, environment: Environment, parameters: GuardedParameters, loop: LoopProperties, amplitude: float
    ) -> None:
        quantum = loop.torque_quantum
        self._tells_late = loop.timing.late <= _LATEST_PART * loop.sample_time
        self._delay = loop.delay
        self._steps = max(1, int(2.0 * amplitude / quantum + 1e-9)) if quantum else 0
        self._down = self._steps * quantum if quantum else 2.0 * amplitude
        super().__init__(environment, parameters, loop)

    def reset(self) -> None:
        """Clear the state and the result of the test."""
        super().reset()
        self._random: random.Random | None = None
        self._open = self._applied = self._moved = 0.0
        self._watch = HoldWatch(self._delay, tells_late=self._tells_late)

    @property
    def hold_found(self) -> str:
        """What the test has found: the declared hold, how the drive contradicts it, or neither."""
        return self._watch.found or (FOUND if self._watch.is_confirmed else UNDECIDED)

    @property
    def energy_resolution(self) -> float:
        """Energy uncertainty of `guarded`; after a contradiction, plus all energy that torques could exchange [J]."""
        return super().energy_resolution + (self._open if self._watch.found else 0.0)

    def step(self, position: float, torque_applied: float) -> EnergyBalance:
        """Book the hold that ended, and compute the next torque; see `Controller.step`."""
        axis, watch = self._axis, self._watch
        if axis.missed or axis.hold_length > 1.0:
            watch.begin_anew()
        moved, applied = abs(position - axis.position), abs(torque_applied)
        balance = super().step(position, torque_applied)
        if self._random is not None:
            self._open += 2.0 * max(applied, self._applied) * max(moved, self._moved)
            self._applied, self._moved = applied, moved
        torque, sign, generator = balance.torque, 0, self._random
        if generator is None:
            generator = self._random = random.Random(repr(position))
        elif self._state.zone and abs(torque) >= self._down:
            toss = generator.getrandbits(1)
            sign = 1 if (torque > 0.0) == bool(toss) else -1
            if not toss:
                balance = self._last = self._lowered(balance)
        watch.take(position, sign)
        return balance._replace(certificate=_NONE) if watch.found else balance

    def _lowered(self, balance: EnergyBalance) -> EnergyBalance:
        """Reduce the torque of a balance, and its queued command, by twice the amplitude; return the new balance."""
        torque, quantum, steps = balance.torque, self._settings.quantum, self._steps
        down = -self._down if torque < 0.0 else self._down
        lowered = (round(torque / quantum) - (steps if torque > 0.0 else -steps)) * quantum if steps else torque - down
        commands, newest, share = self._memory.axis.commands, self._axis.oldest - 1, lowered / torque
        commands.torques[newest] = lowered
        commands.dampers[newest] *= share
        commands.modulated[newest] *= share
        return balance._replace(torque=lowered, damping_rendered=balance.damping_rendered * share)

    def sample_lost(self) -> EnergyBalance:
        """Repeat the last command, its random step included; see `Guarded.sample_lost`."""
        balance = super().sample_lost()
        return balance._replace(certificate=_NONE) if self._watch.found else balance
