"""Energy of one axis by its force sensor, compared with the energy by encoder and commands.

By the force no more than `by_force` came in; by encoder and commands, E - V is no less than `by_encoder` (see
`velocity_loop`), and V is not negative. More by the encoder than by the force: one of them is wrong.
"""

from dataclasses import dataclass, field
from typing import Final

from canhaptic.control.admittance.late_margin import LateMargin, MarginMemory, fall, known_then, margin_memory
from canhaptic.control.admittance.port import BookedHold
from canhaptic.control.admittance.velocity_loop import VelocityLoopSettings, reserve
from canhaptic.kernels import list_of_zeros

ROUNDING: Final = 1e-9
"""Largest difference of two sums of the same energy [J]."""


@dataclass(slots=True)
class ForceEvidence:
    """Both sums for one axis of a group.

    Args:
        latency: Delay of a force in samples.
    """

    latency: int
    by_encoder: float = 0.0  # E - V by encoder and commands alone, at least [J]
    by_force: float = 0.0  # E by the force, at most [J]
    margin: LateMargin = field(default_factory=LateMargin)
    memory: MarginMemory = field(init=False)

    def __post_init__(self) -> None:
        self.memory = margin_memory(self.latency, list_of_zeros)

    def fall(self, change: float) -> None:
        """Apply a lower bound on the change of E - V in the hold that ended [J]."""
        self.by_encoder += change
        fall(self.margin, self.memory, change, 0.0)

    def book(self, loop: VelocityLoopSettings, hold: BookedHold, acceleration: float) -> None:
        """Add the energy bounds of a received force; at the first one the handle may have moved already.

        Args:
            loop: Declared velocity loop of the drive.
            hold: The hold as it was booked.
            acceleration: Largest acceleration of the handle [m/s^2 or rad/s^2].
        """
        if not hold.is_booked:
            return
        if self.by_force == 0.0:
            self.by_encoder -= reserve(loop, 0.0, hold.speed + acceleration * hold.elapsed)
        self.by_force += hold.most

    @property
    def is_contradicted(self) -> bool:
        """Whether encoder and commands show more energy at the SYNC of the last force than the force allows."""
        late = self.by_encoder - self.by_force
        return late > 0.0 and known_then(self.by_encoder, self.margin, self.memory) > self.by_force + ROUNDING


def contradiction(of: str, by_force: float, by_encoder: float) -> str:
    """Message that a sensor contradicts the encoder, with the remedy.

    Args:
        of: The sensor.
        by_force: Energy that came in by its forces, at most [J].
        by_encoder: The same by encoder and commands, at least [J].
    """
    return (
        f"{of}: by its forces at most {by_force:.3g} J came in, by encoder and commands at least {by_encoder:.3g} J: "
        "its sign, scale or offset is wrong, it is frozen, commands do not reach the drive, or drive_mass or loop_gain "
        "is wrong; the velocity is zero, check sensor, bus and drive [FORCE_CONTRADICTED]"
    )
