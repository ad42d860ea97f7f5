"""Controllers that render on several motor axes at once, with one account.

The torque of every motor is constant during a hold, so the energy that came in is -sum(tau_i dq_i) in MOTOR
coordinates, exactly, for every mechanism between motors and hand (eq. 2). Kinematics only shape the torques.

Every axis of a group has its own sample, torque and balance, but its energy -torque * displacement alone proves
nothing: energy that enters through one axis may leave through another. Stored energy, dissipation, surplus and
certificate therefore belong to the group; the balance of an axis has `Branch.GROUP` and, of the energies, h_i alone.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

from canhaptic.control.balance import AT_REST, EnergyBalance
from canhaptic.control.ledger import Ledger
from canhaptic.control.mechanisms.kinematics import Limit
from canhaptic.signals import PlantEnergy, Sample, Truth


class GroupBalance(NamedTuple):
    """One step of a group: the torques to apply next, and the account of the hold that ended. Energies in [J].

    `account` keeps the identity of `canhaptic.control.balance` for the whole group. Its `h_i` is
    sum(interactions) + supplied - uncertainty, with `supplied` from the mover of a moving wall; its `torque` is the
    Euclidean norm of `torques`, for plots only; its `state` is the first state of the network.
    """

    torques: tuple[float, ...]  # command for the next free hold, one per motor axis [N*m or N]
    account: EnergyBalance  # of the whole group
    interactions: tuple[float, ...]  # h_i of each motor axis
    uncertainty: float = 0.0  # uncertainty due to lost samples, subtracted from h_i
    limit: int = 0  # `kinematics.Limit`: reason for zero torques


def group_at_rest(axes: int) -> GroupBalance:
    """Return the balance of the first call after a reset: nothing held, nothing stored."""
    zeros = (0.0,) * axes
    return GroupBalance(zeros, AT_REST, zeros)


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


class AxisGroup:
    """A group of axes of a rig, with its controller and its account.

    Args:
        name: Name of the group, different from every axis name.
        axes: Indices of the axes in the rig, in the order of the controller.
        controller: Controller for this number of axes.

    Attributes:
        ledger: The account of the group.
        balance: Balance of the last step.
        limits: Number of holds in each `Limit` except NONE.
        uncertainty: Uncertainty due to lost samples, subtracted from the ledger's interaction [J].
    """

    def __init__(self, name: str, axes: Sequence[int], controller: GroupController) -> None:
        self.name = name
        self.axes = tuple(axes)
        self.controller = controller
        self.ledger = Ledger()
        self.balance: GroupBalance = group_at_rest(len(self.axes))
        self.limits = {limit.name.lower(): 0 for limit in Limit if limit is not Limit.NONE}
        self.uncertainty = 0.0
        self._limit = Limit.NONE.value

    def step(self, samples: Sequence[Sample]) -> GroupBalance:
        """Return the balance of the hold that ended; `Branch.HELD` if any axis of the group has no fresh sample.

        Args:
            samples: Samples of the whole rig.
        """
        positions, torques = [], []
        for axis in self.axes:
            sample = samples[axis]
            if not sample.fresh:
                self.balance = self.controller.sample_lost()
                return self.balance
            positions.append(sample.position)
            torques.append(sample.torque_applied)
        self.balance = self.controller.step(positions, torques)
        return self.balance

    def book(self, sync_index: int, deadline: int | None = None) -> str:
        """Book the balance of the last step in the group's ledger, and count the limit it reached, if any.

        Args:
            sync_index: Index of the SYNC of that step.
            deadline: Sample times from the first SYNC to that SYNC; None: no SYNC was skipped.

        Returns:
            Message about the limit if the step before did not reach it; empty otherwise.
        """
        self.ledger.add(self.balance.account, sync_index, deadline)
        self.uncertainty += self.balance.uncertainty
        limit, before = self.balance.limit, self._limit
        self._limit = limit
        if not limit:
            return ""
        self.limits[Limit(limit).name.lower()] += 1
        return _LIMIT_TEXTS[limit] if before != limit else ""

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

    def truth(self, truths: Sequence[Truth]) -> Truth:
        """Return the sum of the true energies of the group's axes; work of a mover counts as work of a motor.

        Args:
            truths: True energies, one for each axis of the rig.
        """
        energies = [truths[axis].energy for axis in self.axes]
        motor, user, dissipated, stored = (sum(parts) for parts in zip(*energies, strict=True))
        return Truth(0.0, PlantEnergy(motor - self.ledger.supplied, user, dissipated, stored))
