"""From motor axes to the ports of a network and back: where the group is, and what its network would render there."""

from collections.abc import Sequence
from typing import Final, NamedTuple

from canhaptic.control.mechanisms.kinematics import Kinematics, Limit
from canhaptic.control.multi_axis.group_controller import NetworkEnvironment
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.control.port_hamiltonian.sampled_network import SampledNetwork
from canhaptic.control.port_hamiltonian.shapes.geometry import Rendered
from canhaptic.control.velocity import AdaptiveWindow
from canhaptic.errors import ParameterError

_LONGEST_WINDOW: Final = 0.02
"""Of the velocity from a coarse encoder [s]."""

_Values = Sequence[float]


class RequestedEfforts(NamedTuple):
    """Efforts that oppose the motion, at the motors [N*m or N]."""

    spring: list[float]
    lead: list[float]
    damper: list[float]
    velocity: list[float]  # of the motor axes, inside the contact [rad/s or m/s]
    internal_speed: float  # at which the storages at the ports move by themselves [m/s or rad/s]


class GroupMotion:
    """Follows a group of axes.

    Attributes:
        ports: Of the network.
        limit: Why nothing is rendered; `Limit`.
        engaged: Whether anything can be felt.
        energy: Stored in the network at its state [J]; 0 while a limit holds.
        internal: Dissipated inside it in the last step, beyond what the dampers in the torques took [J].
        entered: Share of the last motion that was inside a contact just entered, else 1.
        network: Followed sample by sample.
        displacement: Of the ports in the last motion [m or rad].
        elapsed: Time of the last motion [s].
        began: Whether the last positions were the first inside the limits of the mechanism.
        moves: Whether a mover may give or take energy.
    """

    def __init__(
        self,
        environment: NetworkEnvironment,
        kinematics: Kinematics,
        loops: tuple[LoopProperties, ...],
        compiled: bool = False,
    ) -> None:
        """Fits environment, mechanism and loops together.

        Raises:
            ParameterError: They do not fit.
        """
        _check_loops(kinematics, loops)
        rendered: Rendered = environment.build(kinematics.dimensions)
        network, geometry = rendered
        if geometry.ports != network.ports or geometry.dimensions != kinematics.dimensions:
            raise ParameterError(
                f"group: the network has {network.ports} ports in any space, its geometry {geometry.ports} in "
                f"{geometry.dimensions} dimensions, the mechanism moves in {kinematics.dimensions}; expected them equal"
            )
        self._kinematics, self._geometry = kinematics, geometry
        self._sample_time, self._delay = loops[0].sample_time, loops[0].delay
        self.network = SampledNetwork(network, self._sample_time, compiled)
        self.ports, self._axes = network.ports, kinematics.axes
        self.moves = geometry.mover(0.0) is not None
        self._windows = [
            AdaptiveWindow(self._sample_time, loop.encoder_count, max(2, round(_LONGEST_WINDOW / self._sample_time)))
            if loop.encoder_count
            else None
            for loop in loops
        ]
        self._smooth = any(window is not None for window in self._windows)
        self._still = (0.0,) * network.ports
        self.reset()

    def reset(self) -> None:
        """Nowhere yet."""
        self.limit, self.engaged, self.energy, self.internal, self.entered = Limit.WORKSPACE.value, False, 0.0, 0.0, 1.0
        self._holds, self._sample = 1, 0
        self._velocity = [0.0] * self._axes
        self._moved = self._still
        self._at_motors = [[0.0] * self._axes for _ in range(self.ports)]
        self._coordinates: tuple[float, ...] | None = None
        self.displacement: tuple[float, ...] = self._still
        self.elapsed, self.began = self._sample_time, True

    @property
    def first_state(self) -> float:
        """First state of the network."""
        return self.network.state[0]

    def begin(self, positions: _Values) -> None:
        """Takes the first positions."""
        self.reset()
        for window, position in zip(self._windows, positions, strict=True):
            if window is not None:
                window.restart(position)
        self._locate(positions)
        if self._coordinates is not None:
            self.network.begin(self._coordinates)
            self._settle()

    def skip(self) -> None:
        """Lets a sample pass that was lost."""
        self._sample += 1

    def follow(self, positions: _Values, displacement: _Values, holds: int) -> None:
        """Takes positions and the motion since the last ones, and lets the network follow them."""
        self.move(positions, displacement, holds)
        self.internal, self.entered = 0.0, 1.0
        if self._coordinates is None:
            self.engaged, self.energy = False, 0.0
            return
        network = self.network
        if self.began:
            network.begin(self._coordinates)
        else:
            was_engaged = network.engaged
            if not network.advance(self._coordinates, self.displacement, self.elapsed):
                self.limit = Limit.UNSOLVED.value
            self.internal = network.internal
            if not was_engaged:
                self.entered = network.entered_share()
        self._settle()

    def move(self, positions: _Values, displacement: _Values, holds: int) -> None:
        """Takes positions and the motion since the last ones, over one hold or several; the network stays.

        Args:
            positions: Of the motor axes [rad or m].
            displacement: Of the motor axes since the last ones [rad or m].
            holds: Sample times since then.
        """
        before, began = self._coordinates, self._sample - (holds - 1)
        self._sample += 1
        self._holds, self.elapsed = holds, holds * self._sample_time
        self._measure_velocity(positions, displacement, holds)
        self._moved = self._mover_motion(began, self._sample)
        self._locate(positions)
        after = self._coordinates
        self.began = before is None
        self.displacement = self._still
        if before is not None and after is not None:
            self.displacement = tuple([b - a for a, b in zip(before, after, strict=True)])

    def _settle(self) -> None:
        self.energy = self.network.energy
        self.engaged = self.network.engaged and self.limit == Limit.NONE.value

    def _locate(self, positions: _Values) -> None:
        """Takes pose and coordinates, the mover's motion taken off."""
        pose = self._kinematics.pose(positions)
        self.limit = pose.limit
        if pose.limit:
            self._coordinates = None
            return
        values, rows = self._geometry.measure(pose.position)
        if self.moves:
            offset = self._geometry.mover(self._sample * self._sample_time) or self._still
            values = tuple([c - w for c, w in zip(values, offset, strict=True)])
        self._coordinates = values
        self._rows = rows
        self._at_motors = [
            [sum([a * jac[axis] for a, jac in zip(row, pose.jacobian, strict=True)]) for axis in range(self._axes)]
            for row in rows
        ]

    def _measure_velocity(self, positions: _Values, displacement: _Values, holds: int) -> None:
        elapsed = holds * self._sample_time
        velocity = [d / elapsed for d in displacement]
        for axis, window in enumerate(self._windows):
            if window is None:
                continue
            if holds == 1:
                velocity[axis] = window.update(positions[axis])
            else:
                window.restart(positions[axis])
                window.velocity = velocity[axis]
        self._velocity = velocity

    def _mover_motion(self, first: int, last: int) -> tuple[float, ...]:
        if not self.moves:
            return self._still
        before = self._geometry.mover(first * self._sample_time) or self._still
        after = self._geometry.mover(last * self._sample_time) or self._still
        return tuple([b - a for a, b in zip(before, after, strict=True)])

    @property
    def coordinates(self) -> tuple[float, ...] | None:
        """Of the ports [m or rad]; None outside the limits of the mechanism."""
        return self._coordinates

    def supplied(self, efforts: _Values) -> float:
        """Returns what the mover gave in the hold that ended [J], the ports having had given efforts."""
        total = 0.0
        if self.moves:
            for effort, moved in zip(efforts, self._moved, strict=True):
                total -= effort * moved
        return total

    def carried(self, after: int, holds: int) -> tuple[tuple[float, ...], ...]:
        """Returns the mover's motion in some holds, as one of the motors at this pose; empty where nothing moves.

        Args:
            after: Samples from the last one to the first of the holds; negative for holds that ended.
            holds: How many; (holds, axes) [rad or m].
        """
        if not self.moves:
            return ()
        first = self._sample + after
        return tuple([self._as_motors(self._mover_motion(first + k, first + k + 1)) for k in range(holds)])

    def _as_motors(self, moved: tuple[float, ...]) -> tuple[float, ...]:
        """Returns the least motion of the motors that moves the ports as the mover does."""
        found = [0.0] * self._axes
        for distance, row in zip(moved, self._at_motors, strict=True):
            square = sum([a * a for a in row])
            if square > 0.0:
                for axis, a in enumerate(row):
                    found[axis] += a * distance / square
        return tuple(found)

    def efforts(self, lead: float) -> RequestedEfforts:
        """Returns what the network would have the motors do, with its springs `lead` holds ahead."""
        network, ports = self.network, self._port_motion()
        damper = network.dampers(ports, self._sample_time)
        spring, leading = network.springs(lead, self._holds, ports)
        velocity = [self.entered * v for v in self._velocity]
        return RequestedEfforts(
            self.to_motors(spring), self.to_motors(leading), self.to_motors(damper), velocity,
            network.internal_motion() / (self._holds * self._sample_time),
        )  # fmt: skip

    def _port_motion(self) -> list[float]:
        """Returns the motion of the ports in one hold, from the smoothed velocity where an encoder is coarse."""
        holds = self._holds
        if not self._smooth:
            return list(self.displacement) if holds == 1 else [d / holds for d in self.displacement]
        return [
            sum([a * v for a, v in zip(row, self._velocity, strict=True)]) * self._sample_time - moved / holds
            for row, moved in zip(self._at_motors, self._moved, strict=True)
        ]

    def to_motors(self, efforts: list[float]) -> list[float]:
        """Returns the efforts at the motors [N*m or N] of efforts at the ports."""
        found = [0.0] * self._axes
        for effort, row in zip(efforts, self._at_motors, strict=True):
            if effort != 0.0:
                for axis, a in enumerate(row):
                    found[axis] += a * effort
        return found


def _check_loops(kinematics: Kinematics, loops: tuple[LoopProperties, ...]) -> None:
    """Checks that there is one loop for each motor axis, and that all have one sample time and delay.

    Raises:
        ParameterError: Otherwise.
    """
    if len(loops) != kinematics.axes:
        raise ParameterError(
            f"group: got the loops of {len(loops)} axes, expected {kinematics.axes}, one for each motor"
        )
    for name in ("sample_time", "delay"):
        values = sorted({getattr(loop, name) for loop in loops})
        if len(values) > 1:
            raise ParameterError(f"group: got {name} {values} on its axes, expected one value: they share one SYNC")
