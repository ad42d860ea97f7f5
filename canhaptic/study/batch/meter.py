"""The figures of one run, gathered while it runs: no trajectory is kept, so that memory does not grow with cycles.

Written for one axis and floats. The scalar path runs it as it stands; the batch form is made from this very source, so
that a figure has one definition. Names are those of `canhaptic.study.figures`, flattened with dots.
"""

from collections.abc import Mapping
from typing import Final

import numpy as np

from canhaptic.haptics.balance import Branch, EnergyBalance
from canhaptic.haptics.environments.protocol import Environment
from canhaptic.study.loop import Array

_FREE, _EXIT = Branch.FREE.value, Branch.EXIT.value

METRICS: Final[dict[str, tuple[str, tuple[str, ...]]]] = {
    "diverged": ("1 where the axis left every place the user could have taken it, else 0", ("diverged",)),
    "cycles": ("SYNCs that the figures are of: all, or those until it diverged", ("cycles",)),
    "interaction": ("true sum(h_i) at the end [J]", ("interaction",)),
    "least_interaction": ("least true sum(h_i) after any hold, eq. 3 [J]", ("least_interaction",)),
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
}
"""Name -> (what it is, the sums of `Meter` that it is made of)."""


class Meter:
    """Running sums and extremes of one axis; energies in [J]. Its attributes are what `METRICS` are made of."""

    def __init__(self, environment: Environment) -> None:
        self._environment = environment
        self._relaxes = environment.relaxes
        self.interaction = self.least_interaction = self.margin = 0.0
        self.believed = self.dissipated = self.believed_margin = self.believed_error = self.surplus = 0.0
        self.torque = self.torque_peak = self.variation = 0.0
        self.contacts = self.damping = self.damping_most = 0.0
        self.damping_least = float("inf")
        self.state = self.force = self.asked = 0.0
        self.highest, self.lowest = -float("inf"), float("inf")
        self.diverged = self.cycles = 0.0

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


def sums_of(metrics: list[str]) -> tuple[str, ...]:
    """Returns the attributes of `Meter` that some metrics are made of, each once."""
    return tuple(dict.fromkeys(name for metric in metrics for name in METRICS[metric][1]))


def metrics_of(metrics: list[str], sums: Mapping[str, Array]) -> dict[str, Array]:
    """Returns metrics made of the sums of many runs, shape (n_runs,) each; NaN where there is nothing to measure."""
    found = {}
    with np.errstate(all="ignore"):
        for metric in metrics:
            names = METRICS[metric][1]
            first, second = sums[names[0]], sums[names[-1]]
            if metric == "travel":
                found[metric] = first - second
            elif metric in ("damping_rendered.least", "damping_rendered.most"):
                found[metric] = np.where(second > 0.0, first, np.nan)
            elif len(names) == 1:
                found[metric] = np.array(first)
            else:
                found[metric] = np.where(second != 0.0, first / second, np.nan)
    return found
