"""The figures of one run, gathered while it runs: no trajectory is kept, so that memory does not grow with cycles.

Written for one axis and floats. The scalar path runs it as it stands; the batch form is made from this very source, so
that a figure has one definition. Names are those of `canhaptic.study.figures`, flattened with dots.
"""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from canhaptic.control.balance import Branch, EnergyBalance
from canhaptic.control.environments.environment import Environment
from canhaptic.study.loop import Array
from canhaptic.study.reference.continuous_reference import REST

_FREE, _START, _EXACT, _STICKY, _FALLBACK, _DEPLETED, _EXIT = (branch.value for branch in list(Branch)[:7])
_LEAST_EFFORT: Final = 1e-9  # [N or N*m] below which there is nothing to be rendered
_LAST: Final = ("diverged", "continuous_travel", "continuous_rest")
_NO_REFERENCE: Final = "NaN in a batch without a continuous run in closed form"

METRICS: Final[dict[str, tuple[str, tuple[str, ...]]]] = {
    "diverged": ("1 where the axis left every place the user could have taken it, else 0", ("diverged",)),
    "cycles": ("SYNCs that the figures are of: all, or those until it diverged", ("cycles",)),
    "interaction": ("true sum(h_i) at the end [J]", ("interaction",)),
    "least_interaction": ("least true sum(h_i) after any hold, eq. 3 [J]", ("least_interaction",)),
    "least_covered": (
        "least true sum(h_i) + (b / T) sum(dq^2) + f_c sum|dq| after any hold: with what damping b and Coulomb "
        "friction f_c of the device dissipate at least; b as declared, else of the simulated plant [J]",
        ("least_covered",),
    ),
    "margin": ("least true sum(h_i) less booked sum(h_r) after any hold, eq. 4 [J]", ("margin",)),
    "believed_margin": ("the same as booked [J]", ("believed_margin",)),
    "believed_error": ("largest |believed - true| sum(h_i) after any hold [J]", ("believed_error",)),
    "surplus_end": ("h_dis at the end [J]", ("surplus",)),
    "torque_peak": ("largest |torque| held [N or N*m]", ("torque_peak",)),
    "force_variation": ("total variation of the torque held, the first step included [N or N*m]", ("variation",)),
    "contact": ("share of the holds that ended in contact", ("contacts", "cycles")),
    "damping_rendered.mean": ("in contact, NaN without [N*s/m or N*m*s/rad]", ("damping", "contacts")),
    "damping_rendered.least": ("in contact, NaN without", ("damping_least", "contacts")),
    "damping_rendered.most": ("in contact, NaN without", ("damping_most", "contacts")),
    "stiffness_rendered.value": (
        "mean force over mean state in contact: over whole contacts the damper averages out; NaN without contact and "
        "where the state relaxes [N/m or N*m/rad]",
        ("force", "state"),
    ),
    "stiffness_rendered.share": ("mean force in contact over the mean effort asked for there", ("force", "asked")),
    "travel": ("largest less least true position [m or rad]", ("highest", "lowest")),
    "certificate": ("weakest promise of any hold: 0 exact, 1 device damping, 2 hand force, 3 hand speed, 4 none",
                    ("certificate",)),
    "branches.free": ("holds without contact", ("free",)),
    "branches.start": ("holds that began a contact", ("start",)),
    "branches.exact": ("holds with the balance solved", ("exact",)),
    "branches.sticky": ("holds that moved out while energy came in", ("sticky",)),
    "branches.fallback": ("holds without an exact solution", ("fallback",)),
    "branches.depleted": ("holds that took more than was stored", ("depleted",)),
    "branches.exit": ("holds that ended a contact", ("exit",)),
}  # fmt: skip
"""Name -> (what it is, the sums of `Meter` that it is made of)."""

CONTINUOUS: Final[dict[str, tuple[str, tuple[str, ...]]]] = {
    "position_error.rms": (f"against the continuous environment, {_NO_REFERENCE} [m or rad]",
                           ("position_squares", "cycles")),
    "position_error.max": (f"the largest, {_NO_REFERENCE} [m or rad]", ("position_worst",)),
    "force_error.rms": (f"torque held less mean of the continuous one, {_NO_REFERENCE} [N or N*m]",
                        ("force_squares", "cycles")),
    "force_error.max": (f"the largest, {_NO_REFERENCE} [N or N*m]", ("force_worst",)),
    "force_variation.ratio": (f"force_variation over that of the continuous force: 1 is as calm; {_NO_REFERENCE}",
                              ("variation", "diverged", "continuous")),
    "limit_cycle": (f"how far it goes to and fro in the last part, where the continuous axis rests; {_NO_REFERENCE} "
                    "[m or rad]", ("last_highest", "last_lowest", *_LAST)),
    "stiffness_at_rest.value": (f"mean force over mean state in the last part, where the continuous axis rests (what a "
                                f"comparison calls stiffness_rendered); {_NO_REFERENCE} [N/m or N*m/rad]",
                                ("last_force", "last_state", "last_asked", "last", *_LAST)),
    "stiffness_at_rest.share": (f"that over the mean effort asked for there; {_NO_REFERENCE}",
                                ("last_force", "last_state", "last_asked", "last", *_LAST)),
}  # fmt: skip
"""The same, of what needs a continuous run beside each loop; a batch has one for walls with spring and damper on one or
two sides, dampers and free space, and plants with nothing but viscous friction and tremor added."""

ALL: Final = {**METRICS, **CONTINUOUS}
"""Every metric."""


class Meter:
    """Running sums and extremes of one axis; energies in [J]. Its attributes are what `METRICS` are made of."""

    def __init__(
        self, environment: Environment, last_from: float = 0.0, damping_per_time: float = 0.0, friction: float = 0.0
    ) -> None:
        """Begins.

        Args:
            environment: That is rendered.
            last_from: SYNC with which the last part of the run begins (`canhaptic.study.figures.last_rows`).
            damping_per_time: b / T of the device [N/m or N*m/rad].
            friction: Coulomb friction of the device in motion [N or N*m].
        """
        self._environment, self._last_from = environment, last_from
        self._relaxes = environment.relaxes
        self._damping_per_time, self._friction = damping_per_time, friction
        self.true_position = self.lost = self.least_covered = 0.0
        self.interaction = self.least_interaction = self.margin = 0.0
        self.believed = self.dissipated = self.believed_margin = self.believed_error = self.surplus = 0.0
        self.torque = self.torque_peak = self.variation = 0.0
        self.contacts = self.damping = self.damping_most = 0.0
        self.damping_least = float("inf")
        self.state = self.force = self.asked = 0.0
        self.highest, self.lowest = -float("inf"), float("inf")
        self.diverged = self.cycles = self.certificate = 0.0
        self.free = self.start = self.exact = self.sticky = self.fallback = self.depleted = self.exit = 0.0
        self.position_squares = self.position_worst = self.force_squares = self.force_worst = 0.0
        self.last_highest, self.last_lowest = -float("inf"), float("inf")
        self.last_force = self.last_state = self.last_asked = self.last = 0.0

    def take(
        self, position: float, true_position: float, torque: float, interaction: float, balance: EnergyBalance
    ) -> None:
        """Takes one SYNC.

        Args:
            position: As the controller saw it [m or rad].
            true_position: [m or rad].
            torque: Applied in the hold that ended [N or N*m].
            interaction: True energy that came in since the start [J].
            balance: What the controller booked.
        """
        self.cycles += 1.0
        self.highest, self.lowest = max(self.highest, true_position), min(self.lowest, true_position)
        self.interaction = interaction
        self.least_interaction = min(self.least_interaction, interaction)
        moved = true_position - self.true_position if self.cycles > 1.0 else 0.0
        self.true_position = true_position
        self.lost += self._damping_per_time * (moved * moved) + self._friction * abs(moved)
        self.least_covered = min(self.least_covered, interaction + self.lost)
        believed = self.believed = self.believed + balance.h_i
        dissipated = self.dissipated = self.dissipated + balance.h_r
        self.margin = min(self.margin, interaction - dissipated)
        self.believed_margin = min(self.believed_margin, believed - dissipated)
        self.believed_error = max(self.believed_error, abs(believed - interaction))
        self.surplus = balance.h_dis
        self.torque_peak = max(self.torque_peak, abs(torque))
        self.variation += abs(torque - self.torque)
        self.torque = torque
        if balance.branch != _FREE and balance.branch != _EXIT:  # noqa: PLR1714 - `in` would search
            self._in_contact(position, torque, balance.damping_rendered)
        self.certificate = max(self.certificate, balance.certificate)
        self._count(balance.branch)
        if self.cycles > self._last_from:
            self._in_last_part(true_position, torque)

    def compare(self, position: float, torque: float, continuous_position: float, continuous_torque: float) -> None:
        """Takes one SYNC beside that of the continuous environment.

        Args:
            position: The true one [m or rad].
            torque: Applied in the hold that ended [N or N*m].
            continuous_position: [m or rad].
            continuous_torque: Its mean over the hold that ended [N or N*m].
        """
        error = position - continuous_position
        self.position_squares += error * error
        self.position_worst = max(self.position_worst, abs(error))
        error = torque - continuous_torque
        self.force_squares += error * error
        self.force_worst = max(self.force_worst, abs(error))

    def _count(self, branch: int) -> None:
        self.free += 1.0 if branch == _FREE else 0.0
        self.start += 1.0 if branch == _START else 0.0
        self.exact += 1.0 if branch == _EXACT else 0.0
        self.sticky += 1.0 if branch == _STICKY else 0.0
        self.fallback += 1.0 if branch == _FALLBACK else 0.0
        self.depleted += 1.0 if branch == _DEPLETED else 0.0
        self.exit += 1.0 if branch == _EXIT else 0.0

    def _in_last_part(self, true_position: float, torque: float) -> None:
        self.last += 1.0
        self.last_highest, self.last_lowest = (
            max(self.last_highest, true_position),
            min(self.last_lowest, true_position),
        )
        if not self._relaxes:
            self.last_force -= torque
            if self._environment.contact(true_position):
                state = self._environment.true_state(true_position, 0.0, 0.0)
                self.last_state += state
                self.last_asked += self._environment.effort(state)

    def _in_contact(self, position: float, torque: float, rendered: float) -> None:
        self.contacts += 1.0
        self.damping += rendered
        self.damping_least = min(self.damping_least, rendered)
        self.damping_most = max(self.damping_most, rendered)
        if not self._relaxes:
            state = self._environment.true_state(position, 0.0, 0.0)
            self.force -= torque
            self.state += state
            self.asked += self._environment.effort(state)


def sums_of(metrics: Sequence[str]) -> tuple[str, ...]:
    """Returns the sums that some metrics are made of, each once."""
    return tuple(dict.fromkeys(name for metric in metrics for name in ALL[metric][1]))


def metrics_of(metrics: Sequence[str], sums: Mapping[str, Array]) -> dict[str, Array]:
    """Returns metrics made of the sums of many runs, shape (n_runs,) each; NaN where there is nothing to measure."""
    with np.errstate(all="ignore"):
        return {metric: _metric(metric, sums) for metric in metrics}


def _metric(metric: str, sums: Mapping[str, Array]) -> Array:
    names = ALL[metric][1]
    first, second = sums[names[0]], sums[names[-1]]
    if metric in ("damping_rendered.least", "damping_rendered.most"):
        return np.where(second > 0.0, first, np.nan)
    if metric.startswith(("limit_cycle", "stiffness_at_rest")):
        return _at_rest(metric, sums)
    if metric == "force_variation.ratio":
        return np.where((sums["diverged"] == 0.0) & (second > _LEAST_EFFORT), first / second, np.nan)
    if metric.endswith("_error.rms"):
        return np.sqrt(first / second)
    if metric == "travel":
        return first - second
    return np.array(first) if len(names) == 1 else np.where(second != 0.0, first / second, np.nan)


def _at_rest(metric: str, sums: Mapping[str, Array]) -> Array:
    """Returns what is measured in the last part, where the continuous axis rests there."""
    rest = sums["continuous_rest"]
    rests = (sums["diverged"] == 0.0) & (rest <= REST * np.maximum(sums["continuous_travel"], 1e-9))
    if metric == "limit_cycle":
        return np.where(rests, np.maximum(0.0, sums["last_highest"] - sums["last_lowest"] - rest), np.nan)
    state, asked = sums["last_state"], sums["last_asked"]
    known = rests & (np.abs(asked) >= _LEAST_EFFORT * sums["last"]) & (state != 0.0)
    return np.where(known, sums["last_force"] / (state if metric.endswith("value") else asked), np.nan)
