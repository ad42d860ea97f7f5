"""EnergyBalance: what one step of a controller did with the energy of one hold. Ledger: the sums of a whole run.

Identity of every step, whatever the algorithm (to 1e-12 of the largest term):

    h_s - h_s_before + h_r - h_i - gen + h_pas - deficit + leak = 0
    h_dis - h_dis_before = gen + deficit - h_pas - paid,      paid = min(leak, h_dis_before + gen + deficit - h_pas)
"""

from enum import IntEnum
from typing import NamedTuple


class Branch(IntEnum):
    """Which rule booked the hold."""

    FREE = 0  # no contact, nothing stored, no torque
    START = 1  # contact begins
    EXACT = 2  # eq. 8 solved, energy flows in or out
    STICKY = 3  # eq. 8 solved by the other root: moving out while injecting
    FALLBACK = 4  # no exact solution; dissipation of the last velocity (eq. 18)
    DEPLETED = 5  # the store is empty and more was taken: deficit
    EXIT = 6  # contact ended; what was left in the store is leaked


class Certificate(IntEnum):
    """Which promise bounded the torque of the next hold, weakest last."""

    EXACT = 0  # no bound was active
    DEVICE_DAMPING = 1
    HAND_FORCE = 2
    HAND_SPEED = 3
    NONE = 4  # the algorithm gives no bound


class EnergyBalance(NamedTuple):
    """One step of a controller: the torque to apply next and the account of the hold that ended. Energies in [J]."""

    torque: float  # command for the next free hold [N*m or N]
    h_i: float  # interaction: energy that came in with the whole applied torque (eq. 2)
    h_pas: float  # part of h_i taken in by the modulated damper (eq. 19), signed
    h_m: float  # h_i - h_pas: what the model received
    h_r: float  # dissipated by the model's damper, >= 0
    h_s: float  # stored after this step, from the state, never accumulated
    h_dis: float  # surplus still to be dissipated after this step
    gen: float  # created by a first-order start (or by an unprotected algorithm)
    deficit: float  # taken out beyond what was stored
    leak: float  # stored energy removed
    paid: float  # part of leak that pays surplus
    branch: int  # Branch
    damping_rendered: float  # damping of model plus modulated damper inside the command [N*s/m or N*m*s/rad]
    certificate: int  # Certificate
    state: float  # displacement of the storage after this step [m or rad]
