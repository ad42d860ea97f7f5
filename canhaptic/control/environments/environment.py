"""Interface of every virtual environment of one axis: a storage, a damper in parallel, and its zones of contact.

The torque of an environment is always

    torque = -effort(state) - damping * velocity

with `state` the displacement of its storage and `velocity` the velocity of that state. A passivity algorithm decides
which state and velocity the energy account permits; the environment maps them to energy and effort.
"""

from typing import Protocol


class Environment(Protocol):
    """A virtual environment of one axis. Immutable: everything that changes belongs to the controller."""

    @property
    def damping(self) -> float:
        """Coefficient of the damper in parallel with the storage [N*s/m or N*m*s/rad], >= 0."""

    @property
    def linear_stiffness(self) -> float | None:
        """Stiffness k when the stored energy is k x^2 / 2 [N/m or N*m/rad]; None when it is anything else.

        A number lets the algorithms use the closed solution of eq. 16, None the safeguarded solve of eq. 8.
        """

    @property
    def relaxes(self) -> bool:
        """True when `relaxed` may change a state."""

    def contact(self, position: float) -> int:
        """Return 0 out of contact, else the number of the zone of contact at a position [m or rad] (eq. 12).

        Going from one zone to another is an exit and a start in one: the states of two zones are not comparable.
        """

    def true_state(self, position: float, displacement: float, previous: float) -> float:
        """Return the state [m or rad] that the continuous environment has, in contact (x = q - q_w of eq. 14).

        Args:
            position: Axis position [m or rad].
            displacement: Motion during the hold that ended here [m or rad].
            previous: The true state before that hold in the same zone, 0 when the zone was entered in it. Only
                environments that are not fixed in space use it.
        """

    def admissible(self, state: float, true: float) -> float:
        """Return the state [m or rad], or the nearest one that the zone of contact of the state `true` has.

        Behind the surface of a wall there is no tension spring: the nearest is then 0. The identity where any state is.
        """

    def stored_energy(self, state: float) -> float:
        """Return the energy [J] stored at a state, >= 0, and 0 at state 0."""

    def effort(self, state: float) -> float:
        """Return the gradient of the stored energy at a state [N or N*m]."""

    def state_of_energy(self, energy: float, like: float) -> float:
        """Return the state [m or rad] that stores `energy` [J] on the branch on which the state `like` lies.

        Returns the nearest state where no state stores that much.
        """

    def relaxed(self, state: float, sample_time: float) -> float:
        """State after one hold of internal relaxation or yield; never stores more.

        The energy lost is dissipated, not leaked. The identity where `relaxes` is False.
        """
