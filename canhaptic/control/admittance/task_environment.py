"""Environment of several displays in the task space of a mechanism, seen from its motor axes.

    p' = J u,   force of the hand in task space f with J' f = F,   speeds of the motors u with J u = p' rendered

F are the forces of the sensors, one on each motor axis. Energy and certificate stay in motor axes: F u = f p'. Where
the pose is singular or outside its workspace nothing is commanded. Walls are limits in task space here; there is room
for the way that the commands under way and the drives still go, taken at the speed of the last command.
"""

from collections.abc import Sequence

from canhaptic.control.admittance.display_mass import DisplayMass
from canhaptic.control.admittance.group_environment import GroupMass
from canhaptic.control.mechanisms.kinematics import Kinematics
from canhaptic.control.port_hamiltonian.gauss import solve_linear
from canhaptic.errors import ParameterError

_Vector = list[float]
_Rows = Sequence[Sequence[float]]


class TaskEnvironment:
    """A mass in task space with the interface of a group of displays; see `GroupMass`.

    Args:
        environment: Environment in task space.
        kinematics: Map between motor axes and task space, of equally many coordinates.
        time_ahead: Longest time for which the last command goes on [s].

    Raises:
        ParameterError: The mechanism has more or fewer task coordinates than axes.
    """

    def __init__(self, environment: GroupMass, kinematics: Kinematics, time_ahead: float) -> None:
        if kinematics.axes != kinematics.dimensions:
            raise ParameterError(
                f"kinematics: got {kinematics.axes} motor axes and {kinematics.dimensions} task coordinates, expected "
                "as many: only then does every speed in task space have one of the motors"
            )
        self._environment, self._kinematics, self._ahead = environment, kinematics, time_ahead
        self._jacobian: _Rows = ()
        self.damping = environment.damping

    def require(self, axes: int) -> None:
        """Make sure that it fits a number of motor axes; raise ParameterError."""
        if axes != self._kinematics.axes:
            raise ParameterError(
                f"kinematics: has {self._kinematics.axes} motor axes, expected {axes}, those of the group"
            )
        self._environment.require(self._kinematics.dimensions)

    def of_axis(self, _axis: int) -> DisplayMass:
        """Return what moves on one motor axis: walls are in task space, not here."""
        return DisplayMass(mass=self._environment.mass, damping=self._environment.damping)

    def speeds_after(self, speeds: _Vector, forces: _Vector, positions: _Vector, time: float) -> _Vector:
        """Return the speeds of the motors after another hold [m/s or rad/s]; see `GroupMass.speeds_after`."""
        pose = self._kinematics.pose(positions)
        if pose.limit:
            self._jacobian = ()
            return [0.0] * len(speeds)
        self._jacobian = jacobian = pose.jacobian
        transposed = [list(column) for column in zip(*jacobian, strict=True)]
        pushed = list(forces)
        before = _times(jacobian, speeds)
        if not solve_linear(transposed, pushed):
            return [0.0] * len(speeds)
        wish = self._environment.speeds_after(before, pushed, list(pose.position), time)
        wish = self._within_walls(wish, before, pose.position, time)
        return wish if solve_linear([list(row) for row in jacobian], wish) else [0.0] * len(speeds)

    def _within_walls(self, wish: _Vector, before: _Vector, place: Sequence[float], time: float) -> _Vector:
        walls, found = self._environment, []
        for k, speed in enumerate(wish):
            ahead = place[k] + self._ahead * before[k]
            high = (walls.upper[k] - ahead) / (time + self._ahead) if walls.upper else speed
            low = (walls.lower[k] - ahead) / (time + self._ahead) if walls.lower else speed
            limited = min(speed, max(high, 0.0)) if walls.upper else speed
            found.append(max(limited, min(low, 0.0)) if walls.lower else limited)
        return found

    def stored(self, speeds: _Vector) -> float:
        """Return the energy of the mass at speeds of the motors [J]; 0 where nothing is rendered."""
        return self._environment.stored(_times(self._jacobian, speeds))

    def lost(self, speeds: _Vector, time: float) -> float:
        """Energy that its damper dissipates in a time [J]."""
        return self._environment.lost(_times(self._jacobian, speeds), time)


def _times(rows: _Rows, vector: _Vector) -> _Vector:
    return [sum(a * b for a, b in zip(row, vector, strict=True)) for row in rows]
