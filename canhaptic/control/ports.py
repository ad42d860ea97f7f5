"""Ports: the parts of a rig that have a controller and an account of their own, one axis or several together.

At a SYNC every port writes its rows among the balances of the cycle. Each axis has a row, in the order of the rig; a
port of several axes has one more for its account, after the rows of all axes.
"""

from collections.abc import Iterable, Sequence
from typing import Any

from canhaptic.control.balance import AT_REST, Branch, EnergyBalance
from canhaptic.control.passivity import Controller
from canhaptic.signals import Sample

_HELD = Branch.HELD.value


class Port:
    """One axis of a rig, with what renders on it; the base of a port of several axes.

    Args:
        name: Name of the port.
        axes: Indices of its axes in the rig.
        row: Index of its account among the rows.
        controller: What renders on its axes.

    Attributes:
        uncertainty: Uncertainty due to lost samples, subtracted from the interaction of its account [J].
    """

    uncertainty = 0.0

    def __init__(self, name: str, axes: Sequence[int], row: int, controller: Any) -> None:
        self.name, self.axes, self.row, self.controller = name, tuple(axes), row, controller

    def step(self, samples: Sequence[Sample], balances: list[EnergyBalance]) -> None:
        """Book the hold that ended, and write the rows of the port.

        Args:
            samples: Samples of the whole rig.
            balances: Rows of the cycle.
        """
        _, position, torque, _, fresh = samples[self.row]
        controller = self.controller
        balances[self.row] = controller.step(position, torque) if fresh else controller.sample_lost()

    def tell_replaced(self, balances: list[EnergyBalance]) -> None:
        """Tell the controller of the torques that a stop sends instead of its own."""
        if balances[self.row].branch != _HELD and hasattr(self.controller, "replace"):
            self.controller.replace(balances[self.row].torque)


class Ports:
    """The ports of a rig, stepped together.

    Args:
        ports: The ports; each axis of the rig is in one.
        dry_run: Whether no torque is sent; a lost sample then makes no energy uncertain.

    Attributes:
        axes: Number of axes.
        rows: Number of rows, those of the axes included.
        several: Ports of several axes, each a `multi_axis.group_controller.AxisGroup`.
        steps: What a cycle steps: each port by itself, or all together where more is to be done.
    """

    def __init__(self, ports: Iterable[Port], *, dry_run: bool = False) -> None:
        self.ports = tuple(ports)
        self.axes = sum(len(port.axes) for port in self.ports)
        self.rows = 1 + max((self.axes - 1, *(port.row for port in self.ports)))
        self.several: tuple[Any, ...] = tuple(port for port in self.ports if port.row >= self.axes)
        render = [port.controller for port in self.ports]
        self._withhold = [each.withhold for each in render if dry_run and hasattr(each, "withhold")]
        self.steps: Sequence[Any] = (self,) if dry_run else self.ports

    @property
    def axes_of_rows(self) -> list[tuple[int, tuple[int, ...]]]:
        """Each row, and the axes whose energy it has."""
        return [*((axis, (axis,)) for axis in range(self.axes)), *((port.row, port.axes) for port in self.several)]

    @property
    def programs(self) -> list[tuple[int, Any]]:
        """Axes whose torques the user's program requests, and the controllers of these axes."""
        return [(port.row, port.controller) for port in self.ports if hasattr(port.controller, "ask")]

    @property
    def alone(self) -> dict[int, Any]:
        """Controller of each axis that is a port by itself, by its index."""
        return {port.row: port.controller for port in self.ports if port.row < self.axes}

    def note_skipped_syncs(self, periods: int) -> None:
        """Record that SYNCs were skipped: the hold that ends next lasted this number of sample times."""
        for port in self.ports:
            if periods > 1 and hasattr(port.controller, "note_skipped_syncs"):
                port.controller.note_skipped_syncs(float(periods))

    def step(self, samples: Sequence[Sample], balances: list[EnergyBalance]) -> None:
        """Step every port; see `Port.step`."""
        for port in self.ports:
            port.step(samples, balances)
        for withhold in self._withhold:
            withhold()

    def balances_of(self, samples: Sequence[Sample]) -> list[EnergyBalance]:
        """Return the rows of a cycle."""
        balances = [AT_REST] * self.rows
        self.step(samples, balances)
        return balances


def axis_ports(controllers: Iterable[Controller]) -> list[Port]:
    """Return a port for each controller, in the order of the axes of the rig."""
    return [Port("", (axis,), axis, each) for axis, each in enumerate(controllers)]
