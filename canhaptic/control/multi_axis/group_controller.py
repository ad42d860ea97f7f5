"""Controllers that render on several motor axes at once, with one account.

The torque of every motor is constant during a hold, so the energy that came in is -sum(tau_i dq_i) in MOTOR
coordinates, exactly, for every mechanism between motors and hand (eq. 2). Kinematics only shape the torques.

Every axis of a group has its own sample, torque and balance, but its energy -torque * displacement alone proves
nothing: energy that enters through one axis may leave through another. Stored energy, dissipation, surplus and
certificate therefore belong to the group; the balance of an axis has `Branch.GROUP` and, of the energies, h_i alone.
"""

from collections.abc import Sequence
from typing import Any, Protocol

from canhaptic.control.balance import Branch, EnergyBalance, GroupBalance, group_at_rest
from canhaptic.control.mechanisms.kinematics import Limit
from canhaptic.control.ports import Port
from canhaptic.signals import Sample


class GroupController(Protocol):
    """An algorithm that renders a network on several motor axes at once.

    Attributes:
        axes: Number of motor axes; every sequence below has one entry for each.
    """

    axes: int

    def reset(self) -> None:
        """Clear the state: zero stored energy, no queued torque, no last positions."""

    def step(self, positions: Sequence[float], torques_applied: Sequence[float]) -> GroupBalance:
        """Book the hold that just ended and return the account with the torques for the next free hold.

        The first call after `reset` only stores the positions: its balance is all zero.

        Args:
            positions: Positions of the motor axes at this SYNC [rad or m].
            torques_applied: Torques that the drives held during the hold that ended here [N*m or N].

        Raises:
            ControlError: A position or torque is not finite, or the computed torque is not.
        """

    def sample_lost(self) -> GroupBalance:
        """Repeat the last commands at a SYNC where the sample of an axis was lost; return a balance without energies.

        Nothing is booked; the next `step` books the total displacement over several holds at its worst-case energy.
        """


class NetworkEnvironment(Protocol):
    """Parameters of an environment in a scene, from which a network for a given task space is built."""

    def build(self, dimensions: int) -> Any:
        """Return the network with its geometry.

        Args:
            dimensions: Number of dimensions of task space.

        Raises:
            ParameterError: The network does not fit that many dimensions, or would not be passive.
        """


_LIMIT_TEXTS = {
    Limit.WORKSPACE.value: "the mechanism is outside its declared workspace: no torque until it is back",
    Limit.SINGULAR.value: "the pose is closer to a singularity than declared: no torque until it has moved away",
    Limit.UNSOLVED.value: "the network's equation did not converge: no torque until it does",
}
"""Limit -> message for the user."""


_GROUP, _HELD = Branch.GROUP.value, Branch.HELD.value


class AxisGroup(Port):
    """A port of several axes, with its controller and its account.

    Args:
        name: Name of the group, different from every axis name.
        axes: Indices of the axes in the rig, in the order of the controller.
        row: Index of its account among the rows.
        controller: Controller for this number of axes.

    Attributes:
        balance: Balance of the last step.
        limits: Number of holds in each `Limit` except NONE.
        news: Message about the limit of the last step if the step before did not reach it; else empty.
    """

    def __init__(self, name: str, axes: Sequence[int], row: int, controller: GroupController) -> None:
        super().__init__(name, axes, row, controller)
        self.balance: GroupBalance = group_at_rest(len(self.axes))
        self.limits = {limit.name.lower(): 0 for limit in Limit if limit is not Limit.NONE}
        self.news = ""

    def step(self, samples: Sequence[Sample], balances: list[EnergyBalance]) -> None:
        """Book the hold that ended, `Branch.HELD` if any axis has no fresh sample, and write the rows of the port.

        Args:
            samples: Samples of the whole rig.
            balances: Rows of the cycle.
        """
        limit = self.balance.limit
        self.balance = balance = self._stepped(samples)
        torques, account, interactions, uncertainty, _ = balance
        self.uncertainty += uncertainty
        branch, certificate = _HELD if account.branch == _HELD else _GROUP, account.certificate
        for axis, torque, h_i in zip(self.axes, torques, interactions, strict=True):
            balances[axis] = _axis_balance(torque, h_i, branch, certificate)
        balances[self.row] = account
        self.news = ""
        if balance.limit:
            self.limits[Limit(balance.limit).name.lower()] += 1
            self.news = _LIMIT_TEXTS[balance.limit] if limit != balance.limit else ""

    def _stepped(self, samples: Sequence[Sample]) -> GroupBalance:
        positions, torques = [], []
        for axis in self.axes:
            sample = samples[axis]
            if not sample.fresh:
                stepped: GroupBalance = self.controller.sample_lost()
                return stepped
            positions.append(sample.position)
            torques.append(sample.torque_applied)
        stepped = self.controller.step(positions, torques)
        return stepped

    def tell_replaced(self, balances: list[EnergyBalance]) -> None:
        """Put zero torques in place of the newest torques of the controller."""
        account = balances[self.row]
        if hasattr(self.controller, "withhold") and account.branch != _HELD:
            self.controller.withhold()
        balances[self.row] = account._replace(torque=0.0)

    def sample(self, samples: Sequence[Sample]) -> Sample:
        """Return the group's entry in the log: position 0, and the norm of its torques.

        Args:
            samples: Samples of the whole rig.
        """
        words, square, fresh = 0, 0.0, True
        for axis in self.axes:
            sample = samples[axis]
            words |= sample.statusword
            square += sample.torque_applied * sample.torque_applied
            fresh = fresh and sample.fresh
        return Sample(samples[0].sync_index, 0.0, square**0.5, words, fresh)


def _axis_balance(torque: float, h_i: float, branch: int, certificate: int) -> EnergyBalance:
    """Return the balance of one axis of a group: torque and h_i, because all else is in the group's account."""
    return EnergyBalance(torque, h_i, 0.0, h_i, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, branch, 0.0, certificate, 0.0)
