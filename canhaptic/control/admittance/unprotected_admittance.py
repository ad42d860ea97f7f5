"""`unprotected` of admittance displays: the environment without protection, and the base of other algorithms.

The other algorithms without a certificate override `_observe` and `_protected`. Energy created by sampling, drives and
the uncertainty of the account is booked as `gen`, energy lost by them as `leak`, so that the account is balanced.
"""

from typing import ClassVar

from canhaptic.control.admittance.admittance_controller import AdmittanceController, Vector
from canhaptic.control.admittance.admittance_environment import AdmittanceAxis, AdmittanceEnvironment
from canhaptic.control.admittance.port import AdmittanceProperties
from canhaptic.control.balance import Certificate, GroupBalance
from canhaptic.units import Parameters

_NONE = Certificate.NONE.value


class NothingToChoose(Parameters):
    """Parameter model of the admittance algorithms that have no parameters."""


class UnprotectedAdmittance(AdmittanceController[AdmittanceAxis]):
    """Controller that renders an environment and does nothing to stay passive."""

    parameters_type: ClassVar[type[Parameters]] = NothingToChoose

    def _begun(self, environment: AdmittanceEnvironment, properties: AdmittanceProperties) -> AdmittanceAxis:
        return AdmittanceAxis(environment, properties, properties.delay + 1)

    def reset(self) -> None:
        """Return to the initial state; see `GroupController`."""
        super().reset()
        self._slips = [0.0] * self.axes
        self._energy = self._begin()  # of the algorithm's own: observed, in the tank, or still to be dissipated [J]
        self._created = 0.0  # by sampling in the last hold; below 0 it was lost [J]

    def _begin(self) -> float:
        """Return the initial energy of a subclass's observer or tank [J]."""
        return 0.0

    def _own(self) -> Vector:
        return [axis.commands.speed - slip for axis, slip in zip(self._each, self._slips, strict=True)]

    def _miss(self) -> None:
        before, self._slips = self._own(), [0.0] * self.axes
        for axis in self._each:
            axis.port.missed += 1
            axis.commands.send(0.0)
        self._environment.go_along(self._inner, before, self._own(), self._time)

    def _answer(self, positions: Vector, forces: Vector) -> GroupBalance:
        environment, each = self._environment, self._each
        holds = [axis.port.book(*seen) for axis, *seen in zip(each, positions, forces, strict=True)]
        before, elapsed = self._own(), holds[0].elapsed
        h_pas = sum([force * slip for force, slip in zip(forces, self._slips, strict=True)]) * elapsed
        sent = sum([force * axis.commands.speed for force, axis in zip(forces, each, strict=True)]) * elapsed
        self._observe(sent, h_pas)
        request = environment.speeds_after(self._inner, before, forces, positions, self._time)
        request, slips = self._protected(request, forces)
        self._slips = []
        for axis, hold, position, speed, slip in zip(each, holds, positions, request, slips, strict=True):
            limited = axis.limited(speed + slip, position, hold.moved / elapsed)
            axis.commands.send(axis.whole(limited))
            self._slips.append(slip if abs(limited - speed - slip) < abs(slip) else 0.0)
        own, interactions = self._own(), tuple([hold.energy for hold in holds])
        environment.go_along(self._inner, before, own, self._time)
        h_i, h_s = sum(interactions), environment.stored(self._inner, own, positions)
        h_r = environment.lost(before, elapsed)
        rest = self._h_s + h_i - h_pas - h_r - h_s
        self._h_s, self._created = h_s, -rest
        energies = h_i, h_pas, h_i - h_pas, h_r, h_s, 0.0, max(0.0, -rest), 0.0, max(0.0, rest), 0.0
        return self._closed(energies, interactions, before, positions, _NONE)

    def _observe(self, energy: float, dissipated: float) -> None:
        """Update the algorithm's own energy for the hold that ended.

        Args:
            energy: Forces times commanded velocities [J].
            dissipated: The part of the added speeds [J].
        """

    def _protected(self, request: Vector, forces: Vector) -> tuple[Vector, Vector]:
        """Return the requested speeds, limited by the algorithm, and added speeds that dissipate [m/s or rad/s]."""
        return request, [0.0] * self.axes
