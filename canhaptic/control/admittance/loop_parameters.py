"""Parameters of `guarded` of an admittance display: its drive and the hand."""

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
    """The gains are at least (1 - spread) times the declared ones; with a `drive_friction` the mass too."""
    energy_allowance: Annotated[float, quantity("J", ge=0.0)] = 0.0
    """Energy that may be given out before any came in: the promise becomes E >= -energy_allowance."""
    max_consecutive_losses: Annotated[int, quantity("count", ge=0, le=16)] = 0
    """Consecutive cycles without a new command at the drive that the certificate survives; only without an integral."""
    largest_hand_force: Annotated[float, quantity("N", "N*m", ge=0.0, le=1e6)] = 0.0
    """OVER-estimate of the force of the hand: lighter masses, for such hands only; not with an integral. 0: none."""
    drive_friction: Annotated[float, quantity("N", "N*m", ge=0.0, le=1e6)] | None = None
    """OVER-estimate of the dry friction of the drive: force and motion are then compared, and the rig stops where they
    do not agree. None: they are not compared. Needed with hand_stiffness; 0 where there is none."""
    drive_damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e6)] = 0.0
    """OVER-estimate of the damping of its bearings, for both."""
    hand_stiffness: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0, le=1e8)] = 0.0
    """OVER-estimate of the stiffness of sensor, grip and hand: lighter masses, for such hands only. 0: not declared.

    Not with an integral, lost commands or jitter; drive_mass too must then be at least 1 - spread of what is declared.
    """
    hand_speed: Annotated[float, quantity("m/s", "rad/s", ge=0.0, le=1e3)] = 0.0
    """OVER-estimate of the speed of the arm behind the grip; with hand_stiffness."""
    hand_mass: Annotated[float, quantity("kg", "kg*m^2", ge=0.0, le=1e6)] = 0.0
    """OVER-estimate of the mass behind the sensor that is rigid with it; with hand_stiffness."""
    hand_damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e6)] = 0.0
    """OVER-estimate of the damping of the grip; with hand_stiffness."""


def loop_settings(parameters: GuardedDisplayParameters, properties: DisplayProperties) -> VelocityLoopSettings:
    """Declared velocity loop; a hold counts with its longest duration, where it costs most and proves least.

    Raises:
        ParameterError: Losses or a hand are declared for a drive with an integral, or a hand where its proof fails.
    """
    _require_what_a_hand_needs(parameters, properties)
    refused = {
        "max_consecutive_losses": "a command that is lost leaves the integral of the drive unknown",
        "largest_hand_force": "no proof covers such a hand with an integral",
        "hand_stiffness": "no proof covers such a hand with an integral",
    }
    for key, why in refused.items():
        if parameters.integral_gain and getattr(parameters, key):
            raise ParameterError(
                f"guarded: {key}: got {getattr(parameters, key)}, expected 0 with an integral_gain: {why}"
            )
    least, jitter = 1.0 - parameters.spread, properties.jitter
    return VelocityLoopSettings(
        properties.longest_hold, properties.delay, parameters.max_consecutive_losses, parameters.drive_mass,
        parameters.loop_gain, parameters.loop_gain * least, parameters.integral_gain, parameters.integral_gain * least,
        properties.encoder_count, properties.torque_limit, properties.handle_acceleration,
        (1.0 - jitter) / (1.0 + jitter),
    )  # fmt: skip


def _require_what_a_hand_needs(parameters: GuardedDisplayParameters, properties: DisplayProperties) -> None:
    """Refuse an incomplete declaration of a hand as spring, damper and mass, and values that contradict one."""
    if not parameters.hand_stiffness:
        for key in ("hand_speed", "hand_mass", "hand_damping"):
            if getattr(parameters, key):
                raise ParameterError(
                    f"guarded: {key}: got {getattr(parameters, key):g}, expected 0 without hand_stiffness, which "
                    "declares the hand; declare that too"
                )
        return
    if parameters.drive_friction is None:
        raise ParameterError(
            "guarded: drive_friction: got none, expected an over-estimate with hand_stiffness, and of drive_damping: "
            "the proof for such a hand needs them"
        )
    why = "the motion that the commands make must be known"
    if parameters.max_consecutive_losses:
        raise ParameterError(
            f"guarded: max_consecutive_losses: got {parameters.max_consecutive_losses}, expected 0 with "
            f"hand_stiffness: {why}"
        )
    if properties.jitter:
        raise ParameterError(f"guarded: sync_jitter: got {properties.jitter:g}, expected 0 with hand_stiffness: {why}")
