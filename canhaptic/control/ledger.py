"""Sums of the energy account of a port (an axis or a group) over a run, and an independent limit on its energy loss."""

from collections.abc import Sequence
from math import inf
from typing import Final, NamedTuple

from canhaptic.control.balance import AT_REST, OUT_OF_CONTACT, Branch, Certificate, EnergyBalance, RunningSum, add
from canhaptic.control.verdict import PASSIVE_TOLERANCE, PortResult
from canhaptic.signals import Sample

DEFAULT_LIMIT: Final = 0.01
"""`energy_loss_limit` of a port that declares none [J]."""
DEFAULT_GROWTH: Final = 0.1
"""`energy_uncertainty_limit` of a port that declares none [W]: a bus that loses 1 % of its frames leaves less uncertain
in every shipped scene (0.084 W at most), one that loses 10 % more in most of those in contact (0.1 to 3 W)."""


class EnergyLossMeter:
    """Energy received through one port, from the applied torques and measured positions alone.

    Unlike in a controller's account, the uncertainty of lost samples is not subtracted: a run would end for energy that
    was never given out. The certain dissipation of the device is added, because a damping certificate relies on it.

    Args:
        name: Name of the port.
        axes: Indices of its axes in the rig.
        limit: Energy that may be returned to the user beyond the allowance [J].
        allowance: Declared energy that may be returned beyond what was received [J].
        damping: Certain damping of the device, one value per axis [N*s/m or N*m*s/rad].
        sample_time: Sample time [s].
        uncertainty_limit: Growth of the uncertainty of its account that is tolerated [W].
        is_of_link: Whether that limit counts only what grows while the link loses samples or commands.

    Attributes:
        energy: Energy received so far; negative if more was returned [J].
        uncertainty: Uncertainty that the algorithm and doubtful samples left when it was last looked at [J].
    """

    def __init__(
        self, name: str, axes: Sequence[int], limit: float, allowance: float, damping: Sequence[float],
        sample_time: float, uncertainty_limit: float = inf, *, is_of_link: bool = False,
    ) -> None:  # fmt: skip
        self.name, self.axes, self.is_of_link = name, tuple(axes), is_of_link
        self.uncertainty_limit, self.uncertainty = uncertainty_limit, 0.0
        self.limit, self.allowance, self.energy = limit, allowance, 0.0
        self.floor = -(limit + allowance)
        self._by_speed = [(axis, value / sample_time) for axis, value in zip(self.axes, damping, strict=True)]
        self._further = self.axes[1:]
        self._positions = dict.fromkeys(self.axes, 0.0)
        self._booked_at = -1

    @property
    def supplied(self) -> float | None:
        """Energy from a far side less what was sent to it, by the meter's own record [J]; None without one."""
        return None

    def take(self, samples: Sequence[Sample], deadline: int) -> bool:
        """Add the energy of the hold that ended; return whether more energy than allowed was returned to the user.

        Args:
            samples: Samples of the whole rig. Holds of this port without a fresh sample are counted with the next one.
            deadline: Sample times from the first SYNC to this one, skipped SYNCs included.
        """
        booked_at, positions = self._booked_at, self._positions
        for axis in self._further:  # a hold counts once every axis has shown where it ended
            if not samples[axis].fresh:
                return False
        for axis, by_speed in self._by_speed:
            _, position, torque, _, fresh = samples[axis]
            if not fresh:
                return False
            moved = position - positions[axis]
            positions[axis] = position
            if booked_at >= 0:
                energy = self.energy - torque * moved  # eq. 2
                self.energy = energy + by_speed * moved * moved / (deadline - booked_at)
        self._booked_at = deadline
        return self.energy < self.floor


_NONE: Final = Certificate.NONE.value


_DUST: Final = 1e-12
"""Part of the energy that flowed, below which a negative margin is the rounding of its sums."""


def without_dust(margin: float, flowed: float) -> float:
    """Return a least margin [J], or 0 where it is rounding of the energy that flowed, in plus out [J].

    Table, picture and `--check` of a run use it, so that they agree; the columns of a log keep every digit.
    """
    return 0.0 if -margin <= min(_DUST * flowed, PASSIVE_TOLERANCE) else margin


class LedgerSummary(NamedTuple):
    """The account of one port over a run. Energies in [J]."""

    energy_in: float  # sum of the positive h_i, what was supplied left out
    energy_out: float  # minus the sum of the negative ones
    supplied: float  # from elsewhere than the port's motors, less what was given away
    stored: float  # at the end
    dissipated: float  # sum of h_r
    generated: float  # sum of gen
    surplus_end: float  # h_dis at the end
    surplus_max: float
    recovered: float  # sum of h_pas
    leaked: float  # sum of leak, of which `paid` paid surplus
    paid: float
    deficit: float
    margin_value: float  # least value of sum(h_i) - sum(h_r) after any hold (eq. 4)
    margin_cycle: int  # the SYNC at which it was reached
    margin_deadline: int  # and the sample times to it
    least_interaction: float  # least value of sum(h_i) after any hold (eq. 3)
    first_below: int | None  # sample times to the first hold after which that sum was below 0; None: never
    certificates: tuple[Certificate, ...]  # that bounded a torque, weakest last
    branches: dict[str, int]  # holds booked by each branch
    damping_least: float  # range of the damping rendered in contact [N*s/m or N*m*s/rad]
    damping_most: float
    has_open_hold: bool  # the last position was lost: the energy since the one before is not booked

    @property
    def certificate(self) -> Certificate:
        """The weakest certificate that bounded a torque; EXACT if no torque acted."""
        return self.certificates[-1] if self.certificates else Certificate.EXACT

    def as_json(self, sample_time: float) -> PortResult:
        """Return the account of a port as `run --json` prints it.

        Args:
            sample_time: Sample time, to convert the cycle of the least margin into a time [s].
        """
        below = self.first_below
        return {
            **({} if below is None else {"first_active": below * sample_time}),
            "in": self.energy_in,
            "out": self.energy_out,
            **({"supplied": self.supplied} if self.supplied else {}),
            "stored": self.stored,
            "dissipated": self.dissipated,
            "generated": self.generated,
            "surplus": {"end": self.surplus_end, "max": self.surplus_max},
            "recovered": self.recovered,
            "leaked": self.leaked,
            "paid": self.paid,
            "deficit": self.deficit,
            "margin": {
                "value": self.margin_value,
                "cycle": self.margin_cycle,
                "time": self.margin_deadline * sample_time,
            },
            "least_interaction": self.least_interaction,
            "certificate": self.certificate.name.lower(),
            "certificates": [certificate.name.lower() for certificate in self.certificates],
            "branches": dict(self.branches),
            "damping_rendered": {"least": self.damping_least, "most": self.damping_most},
            "open_hold": self.has_open_hold,
        }


class Ledger:
    """Sums of a port's energy account over a run, free of rounding drift: one `add` per cycle, a `summary` at any time.

    Attributes:
        interaction: Sum of h_i so far [J] (eq. 3).
        supplied: Part of it that came from elsewhere than the port's motors, less what was given away [J].
    """

    def __init__(self) -> None:
        self._interaction, self._in, self._dissipated, self._supplied = (RunningSum() for _ in range(4))
        self._corrections = tuple(RunningSum() for _ in range(5))  # of h_pas, gen, leak, paid and deficit
        self._branches = [0] * len(Branch)
        self._last = AT_REST
        self.interaction = self.supplied = self._least_interaction = self._least_margin = self._surplus_max = 0.0
        self._least_margin_cycle = self._least_margin_deadline = 0
        self._first_below: int | None = None
        self._certificates = 0  # one bit each
        self._damping_least, self._damping_most = float("inf"), 0.0

    def __repr__(self) -> str:
        sums = self.summary()
        return f"<Ledger: {sums.energy_in:.4g} J in, {sums.energy_out:.4g} J out, margin {sums.margin_value:.4g} J>"

    def add(self, balance: EnergyBalance, cycle: int, deadline: int | None = None) -> None:
        """Add the account of the hold that ended at SYNC `cycle`.

        Args:
            balance: Account of the hold.
            cycle: Index of the SYNC.
            deadline: Sample times to that SYNC; None: no SYNC was skipped.
        """
        torque, h_i, h_pas, _, h_r, _, surplus, gen, deficit, leak, paid, branch, rendered, certificate, _, supplied = (
            balance
        )
        self._branches[branch] += 1
        self._last = balance
        if surplus > self._surplus_max:
            self._surplus_max = surplus
        if torque or (h_i and certificate == _NONE):  # without one nothing was to be bounded
            self._certificates |= 1 << certificate
        if h_i or h_r or supplied:
            self._add_flows(h_i, h_r, supplied, cycle, cycle if deadline is None else deadline)
        if h_pas or leak or deficit or gen:
            for total, term in zip(self._corrections, (h_pas, gen, leak, paid, deficit), strict=True):
                if term:
                    add(total, term)
        if branch not in OUT_OF_CONTACT:
            if rendered < self._damping_least:
                self._damping_least = rendered
            if rendered > self._damping_most:
                self._damping_most = rendered

    def _add_flows(self, h_i: float, h_r: float, supplied: float, cycle: int, deadline: int) -> None:
        self.interaction = interaction = add(self._interaction, h_i)
        came_in = h_i
        if supplied:
            self.supplied = add(self._supplied, supplied)
            came_in -= supplied
        if came_in > 0.0:
            add(self._in, came_in)
        if interaction < self._least_interaction:
            self._least_interaction = interaction
            if self._first_below is None and interaction < -PASSIVE_TOLERANCE:
                self._first_below = deadline
        dissipated = add(self._dissipated, h_r) if h_r else self._dissipated.value
        if interaction - dissipated < self._least_margin:
            self._least_margin = interaction - dissipated
            self._least_margin_cycle, self._least_margin_deadline = cycle, deadline

    def summary(self) -> LedgerSummary:
        """Return the sums of the account so far."""
        energy_in = self._in.value
        margin = without_dust(self._least_margin, 2.0 * energy_in - self._interaction.value)
        recovered, generated, leaked, paid, deficit = (total.value for total in self._corrections)
        return LedgerSummary(
            energy_in=energy_in,
            energy_out=energy_in + self._supplied.value - self._interaction.value,
            supplied=self._supplied.value,
            stored=self._last.h_s,
            dissipated=self._dissipated.value,
            generated=generated,
            surplus_end=self._last.h_dis,
            surplus_max=self._surplus_max,
            recovered=recovered,
            leaked=leaked,
            paid=paid,
            deficit=deficit,
            margin_value=margin,
            margin_cycle=self._least_margin_cycle if margin else 0,
            margin_deadline=self._least_margin_deadline if margin else 0,
            least_interaction=self._least_interaction,
            first_below=self._first_below,
            certificates=Certificate.of(self._certificates),
            branches={branch.name.lower(): self._branches[branch] for branch in Branch},
            damping_least=min(self._damping_least, self._damping_most),
            damping_most=self._damping_most,
            has_open_hold=self._last.branch == Branch.HELD,
        )
