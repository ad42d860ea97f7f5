"""The holds of a stop: sampled, booked and checked like all others, while the torque falls to what the stop holds.

A stop holds 0, or on an axis that hangs a declared weight until its brake does. A torque of 0 takes nothing,
with any torques under way, so that it may be sent in any hold. A ramp is tried only where a certificate bounds it: a
smaller torque in the direction of a certified one is certified too, and by the promise of `guarded` no more energy than
its account holds can come out from now on, however long the torques last. So a ramp that begins with at most
`energy_loss_limit` in the account gives out no more than that. Otherwise, and without a certificate, the torque falls
to 0 in one hold.
"""

from collections.abc import Sequence
from math import inf
from typing import Any

from canhaptic.control.balance import Branch, Certificate, EnergyBalance
from canhaptic.control.ledger import DEFAULT_LIMIT
from canhaptic.control.ports import Port, Ports
from canhaptic.signals import Sample

_HELD, _NO_CERTIFICATE = Branch.HELD.value, Certificate.NONE.value


class BookedStop(Ports):
    """Ports of a rig in the holds of its stop: they book as before, and the torques of the stop replace theirs.

    Args:
        ports: Ports of the rig.
        dry_run: Whether no torque is sent.
        axes: Parameters of each axis, with its brake and its limit of energy.
        bus: Parameters of the bus, with sample time and longest ramp.
        to_act: Holds until every torque that was sent has acted and is booked.

    Attributes:
        left: Holds that are still to come.
        is_ramp: Whether the torque of an axis falls in more than one hold.
    """

    def __init__(self, ports: Sequence[Port], axes: Sequence[Any], bus: Any, to_act: int, *, dry_run: bool) -> None:
        super().__init__(ports, dry_run=dry_run)
        self.steps = (self,)
        self._held = [(0.0, 0) if dry_run else held_by(axis, bus.sample_time_ns, to_act) for axis in axes]
        longest = max(1, round(bus.stop_ramp * 1e9) // bus.sample_time_ns)
        self._ramps = [1] * self.axes  # holds until the torque is 0
        for port in self.ports:
            limits = [axes[axis].energy_loss_limit for axis in port.axes]
            limit = min(one if isinstance(one, float) else DEFAULT_LIMIT for one in limits)
            hangs = any(axes[axis].brake is not None for axis in port.axes)
            if not hangs and getattr(port.controller, "releasable", inf) <= limit:
                for axis in port.axes:
                    self._ramps[axis] = longest
        self._fading = [port for port in self.ports if hasattr(port.controller, "fade")]
        self._falling = [port for port in self.ports if not hasattr(port.controller, "fade")]
        self._to_act, self._hold, self._sent = to_act, 0, dict[int, float]()
        self.is_ramp = any(ramp > 1 for ramp in self._ramps)
        self.left = max([*(holds for _, holds in self._held), *(ramp - 1 for ramp in self._ramps)]) + to_act

    @property
    def has_come_down(self) -> bool:
        """Whether nothing but weights acts now, for the first time, on the axes with a brake: it may be set."""
        return self._hold == self._to_act - 1

    def step(self, samples: Sequence[Sample], balances: list[EnergyBalance]) -> None:
        """Book the hold that ended, and write its rows with the torques of the stop."""
        self._hold, self.left = self._hold + 1, self.left - 1
        shares = [max(0.0, 1.0 - self._hold / holds) for holds in self._ramps]
        for port in self._fading:
            port.controller.fade(shares[port.axes[0]])
        super().step(samples, balances)
        for port in self._falling:
            for axis in port.axes:
                balances[axis] = self._replaced(axis, balances[axis], shares[axis])
            port.tell_replaced(balances)

    def _replaced(self, axis: int, balance: EnergyBalance, share: float) -> EnergyBalance:
        """Return the balance of an axis with the torque of the stop."""
        weight, holds = self._held[axis]
        is_held = self._hold <= holds
        if balance.branch == _HELD and not is_held:  # the last torque once more, and no ramp after it
            self._ramps[axis] = 1
            return balance._replace(torque=self._sent.get(axis, balance.torque))
        torque = weight if is_held else balance.torque * share
        self._sent[axis] = torque
        return balance._replace(
            torque=torque, certificate=_NO_CERTIFICATE if is_held and torque else balance.certificate
        )


def held_by(axis: Any, sample_time_ns: int, to_act: int) -> tuple[float, int]:
    """Return the weight that a stop holds on an axis until its brake does [N*m or N], and for how many holds."""
    brake = axis.brake
    if brake is None:
        return 0.0, 0
    return brake.holds_weight, to_act + brake.holds_until_set(sample_time_ns)
