"""What `guarded` asks to be declared of the drive of an admittance display, and of the hand."""

from typing import Annotated

from canhaptic.control.admittance.properties import DisplayProperties
from canhaptic.control.admittance.velocity_loop import VelocityLoopSettings
from canhaptic.errors import ParameterError
from canhaptic.units import Parameters, quantity


class GuardedDisplayParameters(Parameters):
    """Parameters of an admittance display on which its certificate rests."""

    drive_mass: Annotated[float, quantity("kg", "kg*m^2", gt=0.0, le=1e6)]
    """OVER-estimate of the mass that the drive moves up to the sensor."""
    loop_gain: Annotated[float, quantity("N*s/m", "N*m*s/rad", gt=0.0, le=1e9)]
    """OVER-estimate of the gain of the drive's velocity loop: 2 pi f M for a bandwidth of f."""
    integral_gain: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0, le=1e12)] = 0.0
    """OVER-estimate of the loop's integral gain; of a position loop: its gain times `loop_gain`. 0: no integral."""
    spread: Annotated[float, quantity("1", ge=0.0, lt=1.0)] = 0.2
    """The gains are at least 1 - spread of what is declared; with a `drive_friction` the mass too."""
    energy_allowance: Annotated[float, quantity("J", ge=0.0)] = 0.0
    """Energy that may be given out before any came in: the promise becomes E >= -energy_allowance."""
    max_consecutive_losses: Annotated[int, quantity("count", ge=0, le=16)] = 0
    """Consecutive cycles without a new command at the drive that the certificate survives; only without an integral."""
    largest_hand_force: Annotated[float, quantity("N", "N*m", ge=0.0, le=1e6)] = 0.0
    """OVER-estimate of the force of the hand: lighter masses, for such hands only; not with an integral. 0: none."""
    drive_friction: Annotated[float, quantity("N", "N*m", ge=0.0, le=1e6)] | None = None
    """OVER-estimate of the dry friction of the drive: force and motion are then compared, and the rig stops where they
    do not agree. None: they are not compared."""
    drive_damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e6)] = 0.0
    """OVER-estimate of the damping of its bearings, for that comparison."""


def loop_settings(parameters: GuardedDisplayParameters, properties: DisplayProperties) -> VelocityLoopSettings:
    """Returns what is declared of the drive; a hold lasts as long as it may, which costs and proves the least.

    Raises:
        ParameterError: Losses or a largest force of the hand are declared for a drive with an integral.
    """
    refused = {
        "max_consecutive_losses": "a command that is lost leaves the integral of the drive unknown",
        "largest_hand_force": "what such a hand can take from an integral is not proved",
    }
    for key, why in refused.items():
        if parameters.integral_gain and getattr(parameters, key):
            raise ParameterError(
                f"guarded: {key}: got {getattr(parameters, key)}, expected 0 with an integral_gain: {why}"
            )
    least, longest = 1.0 - parameters.spread, properties.sample_time * (1.0 + properties.jitter)
    return VelocityLoopSettings(
        longest, properties.delay, parameters.max_consecutive_losses, parameters.drive_mass,
        parameters.loop_gain, parameters.loop_gain * least, parameters.integral_gain, parameters.integral_gain * least,
        properties.encoder_count, properties.torque_limit, properties.handle_acceleration,
    )  # fmt: skip
