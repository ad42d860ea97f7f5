"""Homing mode of the simulated drive (IEC 61800-7-201, 0x6060 = 6).

Methods 33 and 34 search for the index pulse, 35 and 37 take the present position. The index pulse comes once per motor
turn (0x608F, by default 4096 counts). The drive closes a PI velocity loop, tuned for the mass of its motor.
"""

from typing import Any, Final

from canhaptic.canopen import objects
from canhaptic.canopen.objects import DataType, StatusBit
from canhaptic.sim.drive.profile.object_store import ObjectStore, refuse_unless

_START, _HALT = 1 << 4, 1 << 8  # of the controlword
_REACHED, _ATTAINED = int(StatusBit.TARGET_REACHED), 1 << 12  # of the statusword; 12 means this in homing mode alone
_DIRECTIONS: Final = {33: -1, 34: 1}
_HERE: Final = (35, 37)
_COUNTS: Final = 4096
_BANDWIDTH: Final = 50.0  # [rad/s] of the velocity loop
_INTEGRAL: Final = 10.0  # [1/s]


class Homing:
    """A homing motion: its velocity command and its velocity loop.

    Args:
        store: Object store.
        motor: Motor whose mass tunes the loop; 1 kg or kg*m^2 if it states none.

    Attributes:
        zero: Encoder count at which 0x6064 is 0.
        bits: Bits 10 and 12 of the statusword.
    """

    def __init__(self, store: ObjectStore, motor: object) -> None:
        self._method = store.entry(objects.HOMING_METHOD, DataType.INTEGER8)
        self._method.check = refuse_unless((0, *_DIRECTIONS, *_HERE).__contains__)
        self._speed = store.optional(objects.HOMING_SPEEDS, DataType.UNSIGNED32, 2)
        self._offset = store.optional(objects.HOME_OFFSET, DataType.INTEGER32)
        self._pitch = max(1, store.optional(objects.ENCODER_RESOLUTION, DataType.UNSIGNED32, 1).number or _COUNTS)
        plant: Any = getattr(motor, "parameters", None)
        self._mass = float(getattr(plant, "mass", 1.0))
        self.zero = 0
        self.leave()

    def leave(self) -> None:
        """End homing because the drive is disabled or changes its mode; `zero` stays."""
        self.bits = _REACHED
        self._was_asked = self._is_active = False
        self._integral = 0.0
        self._before: tuple[int, int] | None = None  # time and encoder of the last step

    def step(self, now: int, encoder: int, velocity: float, controlword: int) -> float:
        """Return the force that the loop demands [kg*count/s^2 or kg*m^2*count/s^2].

        Args:
            now: Time [ns].
            encoder: Counts of the encoder since power-on.
            velocity: Velocity of the encoder [count/s].
            controlword: 0x6040.
        """
        is_asked = bool(controlword & _START)
        if is_asked != self._was_asked:  # the rising edge starts, the falling one interrupts
            interrupts = self._is_active or is_asked
            self.bits = 0 if is_asked else _REACHED if interrupts else self.bits
            self._was_asked = self._is_active = is_asked
        then, last = self._before or (now, encoder)
        wanted = self._follow(encoder, last) if self._is_active and not controlword & _HALT else 0
        error = wanted - velocity
        self._integral += error * (now - then) * 1e-9 * _INTEGRAL
        self._before = now, encoder
        return self._mass * _BANDWIDTH * (error + self._integral)

    def _follow(self, encoder: int, last: int) -> int:
        """Return the velocity towards the index [count/s]; 0 once the home position is found."""
        direction = _DIRECTIONS.get(self._method.number, 0)
        turns = encoder // self._pitch, last // self._pitch
        if direction and (turns[0] - turns[1]) * direction <= 0:
            return direction * self._speed.number
        if direction or self._method.number in _HERE:
            home = max(turns) * self._pitch if direction else encoder
            self.zero = home - self._offset.number
            self.bits, self._is_active = _REACHED | _ATTAINED, False
        return 0
