"""What a simulated drive does when its power stage changes state: announce a fault, end a reaction after its time."""

from collections.abc import Callable
from typing import Final

from canhaptic.sim.drive.profile.emergency import EmergencyProducer
from canhaptic.sim.drive.profile.servo import Servo
from canhaptic.sim.drive.profile.state_machine import DriveState
from canhaptic.sim.drive.profile.timers import Timers

_TRANSIENT: Final = frozenset((DriveState.FAULT_REACTION_ACTIVE, DriveState.QUICK_STOP_ACTIVE))


class Reactions:
    """Follows the states of a servo.

    Args:
        servo: The servo.
        emergency: Announces its faults.
        timers: Timers of the drive.
        period: Returns the present period of SYNC or SYNC0 [ns].
        settle: Ends a reaction.
    """

    def __init__(
        self, servo: Servo, emergency: EmergencyProducer, timers: Timers, period: Callable[[], int],
        settle: Callable[[], None],
    ) -> None:  # fmt: skip
        self._servo, self._emergency, self._timers, self._period = servo, emergency, timers, period
        self._timer = timers.add(lambda _due: settle())

    def restart(self) -> None:
        """Time the reaction in which the servo is, if any, from now on."""
        if self._servo.state in _TRANSIENT:
            self._start()

    def follow(self) -> bool:
        """Announce a fault, time a reaction, withdraw what was reset; return whether the state had changed."""
        servo = self._servo
        if servo.fault_code:
            self._emergency.announce(servo.fault_code)
            servo.fault_code = 0
            servo.fault()
        if not servo.has_event:
            return False
        servo.has_event = False
        if servo.state in _TRANSIENT and not self._timers.is_running(self._timer):
            self._start()
        if servo.was_reset:
            servo.was_reset = False
            self._emergency.withdraw()
        return True

    def _start(self) -> None:
        self._timers.start(self._timer, self._servo.now + self._period() * 3 // 2)  # so that exactly one SYNC shows it
