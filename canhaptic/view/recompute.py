"""Feeds the logged inputs to the same controller again: every logged output must come out bit for bit."""

import struct
from typing import Final, NamedTuple, Protocol

from canhaptic.haptics.balance import EnergyBalance
from canhaptic.haptics.passivity.protocol import Controller
from canhaptic.logs.energy_reader import EnergyLog

_LOGGED: Final = tuple("torque_command" if name == "torque" else name for name in EnergyBalance._fields)


_ALL: Final = struct.Struct(f"{len(_LOGGED)}d")
_ONE: Final = struct.Struct("d")


class Holder(Controller, Protocol):
    """A controller that can also book a cycle without a fresh sample."""

    def hold(self) -> EnergyBalance:
        """Books nothing yet and keeps the last torque."""


class Mismatch(NamedTuple):
    """The first output that differs."""

    port: str
    cycle: int
    quantity: str
    logged: float
    recomputed: float


def recompute(log: EnergyLog, port: str, controller: Holder) -> Mismatch | None:
    """Returns the first difference between the logged outputs of a port and those computed again; None when equal.

    Args:
        log: An open energy log that holds the run from its first cycle.
        port: Name of the axis.
        controller: Made from the configuration of the run; it is reset first.
    """
    controller.reset()
    logged = log.ports[port]
    outputs = zip(*(logged[name].tolist() for name in _LOGGED), strict=True)
    inputs = zip(logged["position"].tolist(), logged["torque_applied"].tolist(), logged["fresh"].tolist(), strict=True)
    for row, ((position, torque, fresh), expected) in enumerate(zip(inputs, outputs, strict=True)):
        balance = controller.step(position, torque) if fresh else controller.hold()
        if _ALL.pack(*balance) != _ALL.pack(*expected):
            number = next(n for n, values in enumerate(zip(balance, expected, strict=True)) if _differ(*values))
            cycle = int(log.timing["sync_index"][row])
            return Mismatch(port, cycle, _LOGGED[number], expected[number], balance[number])
    return None


def _differ(left: float, right: float) -> bool:
    return _ONE.pack(left) != _ONE.pack(right)
