"""`unprotected` of an admittance display: the virtual mass without protection, and the base of other algorithms.

The other algorithms without a certificate override `respond`. Energy created by sampling, the drive and the uncertainty
of the account is booked as `gen`, energy lost by them as `leak`, so that the account is balanced.
"""

from typing import ClassVar, NamedTuple

from canhaptic.control.admittance.admittance_environment import AdmittanceController
from canhaptic.control.balance import AT_REST, Branch, Certificate, EnergyBalance
from canhaptic.kernels import new
from canhaptic.units import Parameters

_EXACT, _FREE, _NONE = Branch.EXACT.value, Branch.FREE.value, Certificate.NONE.value


class NothingToChoose(Parameters):
    """Parameter model of the admittance algorithms that have no parameters."""


class SampledHold(NamedTuple):
    """The hold that ended, and the next state of the mass."""

    energy: float  # that came in, at least [J]
    elapsed: float  # [s]
    velocity: float  # [m/s or rad/s]
    before: float  # the last command [m/s or rad/s]
    request: float  # speed of the mass after another hold [m/s or rad/s]
    force: float  # of the hand at its end [N or N*m]


class UnprotectedAdmittance(AdmittanceController):
    """Controller that renders a virtual mass and does nothing to stay passive."""

    parameters_type: ClassVar[type[Parameters]] = NothingToChoose

    def reset(self) -> None:
        """Clear the state; see `Controller.reset`."""
        super().reset()
        self._h_s = self._slip = 0.0
        self._energy = 0.0  # of the algorithm's own: observed, in the tank, or still to be dissipated [J]
        self._created = 0.0  # by sampling in the last hold; below 0 it was lost [J]

    def first_energy(self, position: float) -> float:
        """Return the initial value of the algorithm's own energy variable, at the first position [J]."""
        return 0.0

    def respond(self, hold: SampledHold) -> tuple[float, float, float]:
        """Return speed and added speed of the next command, and the energy that the last added speed dissipated.

        Returns:
            Speed of the mass [m/s or rad/s], additional speed that dissipates energy [m/s or rad/s], and the energy
            that this additional speed dissipated in the hold that ended [J].
        """
        return hold.request, 0.0, 0.0

    def _account(self, position: float, torque_applied: float) -> EnergyBalance:
        display, commands, force, inner = self._display, self._commands, -torque_applied, self._inner
        environment, time = self._environment, self._time
        if not display.port.started:
            display.begin(position, force)
            self._energy = self.first_energy(position)
            return AT_REST
        booked = display.port.book(position, force)
        before, elapsed, velocity = commands.speed - self._slip, booked.elapsed, booked.moved / booked.elapsed
        request = environment.speed_after(inner, before, force, position, time)
        hold = new(SampledHold, (booked.energy, elapsed, velocity, before, request, force))
        request, slip, h_pas = self.respond(hold)
        speed = display.limited(request + slip, position, velocity)
        commands.send(display.whole(speed))
        self._slip = slip if abs(speed - request - slip) < abs(slip) else 0.0
        own = commands.speed - self._slip
        environment.go_along(inner, before, own, time)
        h_s, h_r = environment.stored(inner, own, position), environment.damping * before * before * elapsed
        rest = self._h_s + hold.energy - h_pas - h_r - h_s
        self._h_s, self._created = h_s, -rest
        branch = _EXACT if commands.speed != 0.0 or before != 0.0 else _FREE
        return new(EnergyBalance, (
            commands.speed, hold.energy, h_pas, hold.energy - h_pas, h_r, h_s, 0.0, max(0.0, -rest), 0.0,
            max(0.0, rest), 0.0, branch, environment.damping, _NONE, environment.stretch(position), 0.0,
        ))  # fmt: skip

    def lasted(self, periods: float) -> None:
        """Treat skipped SYNCs as lost samples, during which the last command continued to act."""
        if self._axis.started:
            skipped, own = round(periods) - 1, self._commands.speed - self._slip
            self._axis.missed += skipped
            for _ in range(skipped):
                self._environment.go_along(self._inner, own, own, self._time)

    def _command_unseen(self) -> float:
        """Send and return the command of a SYNC without a sample: 0."""
        before, self._slip = self._commands.speed - self._slip, 0.0
        self._commands.send(0.0)
        self._environment.go_along(self._inner, before, 0.0, self._time)
        self._axis.missed += 1
        return 0.0
