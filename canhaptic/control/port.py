"""The port between the user's continuous world and the sampled virtual environment. The sign is written here, once.

Energy flowing INTO the virtual environment is positive (eq. 1). A torque is the one the actuator applies to the user's
side, so a wall that pushes back against motion in -q has a positive torque and takes energy in:
-torque * displacement > 0.
"""


def interaction_energy(torque: float, displacement: float) -> float:
    """Returns the energy [J] that entered the environment during one hold of constant torque (eq. 2): exact.

    Args:
        torque: Held by the actuator during the whole hold [N*m or N].
        displacement: Motion of the same axis from the start to the end of the hold [rad or m].
    """
    return -torque * displacement
