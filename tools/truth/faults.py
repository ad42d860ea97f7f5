"""Faults of bus, drives, host and foreign nodes in a random scene, and the time until the torque is zero.

Left out is what no frame shows (docs/safety.md): a bit that a gateway turns in a position, a TPDO of ours that another
node sends, a stuck encoder, and commands of another master where no torque is read back.
"""

import copy
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Final

import can
import numpy as np

from canhaptic.drive.clock import VirtualClock
from canhaptic.scene.build import Experiment
from canhaptic.sim.drive.profile.timers import NEVER
from tools.truth.scenes import TruthScene

_LATE: Final = 0.3  # share of a run before which no fault begins
_FOR_GOOD: Final = 1000.0  # s
_NODE: Final = 1
_TPDO, _RPDO, _SDO, _SYNC, _HEARTBEAT, _OURS = 0x181, 0x201, 0x601, 0x080, 0x701, 0x77E
_ON_THE_BUS: Final[dict[str, Callable[[float, np.random.Generator], dict[str, Any]]]] = {
    "drop": lambda _, chance: {"drop": 10.0 ** chance.uniform(-3.0, -1.0)},
    "drop_burst": lambda _, chance: {"drop": chance.uniform(0.02, 0.1), "drop_burst": 3.0},
    "drop_tpdo": lambda _, chance: {"drop": chance.uniform(0.02, 0.3), "direction": "to_master", "ids": [_TPDO]},
    "drop_rpdo": lambda _, chance: {"drop": chance.uniform(0.02, 0.3), "direction": "to_drive", "ids": [_RPDO]},
    "drop_sync": lambda _, chance: {"drop": chance.uniform(0.02, 0.2), "direction": "to_drive", "ids": [_SYNC]},
    "duplicate": lambda _, chance: {"duplicate": chance.uniform(0.01, 0.2)},
    "reorder": lambda period, chance: {
        "reorder": chance.uniform(0.01, 0.1), "reorder_delay": chance.uniform(0.05, 0.4) * period,
        "ids": [_TPDO, _RPDO],
    },
    "late_tpdo": lambda period, chance: {
        "delay": chance.choice([1.2, 2.3, chance.uniform(1.0, 3.0)]) * period, "direction": "to_master",
        "ids": [_TPDO],
    },
    "truncate": lambda _, chance: {"truncate": chance.uniform(0.01, 0.1), "ids": [_TPDO]},
    "refuse": lambda _, chance: {"refuse": chance.uniform(0.01, 0.1)},
    "jitter": lambda period, chance: {"jitter": chance.uniform(0.02, 0.15) * period},
    "foreign_frames": lambda _, chance: {"foreign_rate": chance.uniform(100.0, 2000.0)},
    "tpdo_gone": lambda _, __: {"drop": 1.0, "ids": [_TPDO]},
    "rpdo_gone": lambda _, __: {"drop": 1.0, "ids": [_RPDO]},
    "rpdo_and_sdo_gone": lambda _, __: {"drop": 1.0, "ids": [_RPDO, _SDO]},
    "sync_gone": lambda _, __: {"drop": 1.0, "ids": [_SYNC]},
    "all_to_drive_gone": lambda _, __: {"drop": 1.0, "direction": "to_drive"},
    "all_to_master_gone": lambda _, __: {"drop": 1.0, "direction": "to_master"},
    "all_gone": lambda _, __: {"drop": 1.0},
    "drive_heartbeat_gone": lambda _, __: {"drop": 1.0, "ids": [_HEARTBEAT]},
    "master_heartbeat_gone": lambda _, __: {"drop": 1.0, "ids": [_OURS]},
}  # fmt: skip
_OF_THE_BUS: Final = ("freeze", "stall", "stall_often", "bus_off", "bus_off_for_good")
_TRIGGERED: Final[dict[str, Callable[["FaultWatch"], None]]] = {
    "drive_fault": lambda watch: watch.drive.inject_fault(0x2310),
    "nmt_stop": lambda watch: watch.send(0x000, 0x02, _NODE),
    "nmt_reset": lambda watch: watch.send(0x000, 0x81, _NODE),
    "foreign_sync": lambda watch: watch.send(_SYNC),
    "foreign_rpdo": lambda watch: watch.send(0x200 + _NODE, 0x0F, 0, 0xF4, 0x01),
    "foreign_sdo": lambda watch: watch.send(0x600 + _NODE, 0x40, 0x41, 0x60, 0, 0, 0, 0, 0),
    "foreign_shutdown": lambda watch: watch.send(0x600 + _NODE, 0x2B, 0x40, 0x60, 0, 0x06, 0, 0, 0),
    "encoder_jump": lambda watch: watch.jump(),
    "torque_not_finite": lambda watch: watch.break_controller(),
    "twin": lambda watch: watch.answer_twice(),
}
_TORQUES: Final[dict[str, Callable[[np.random.Generator], dict[str, Any]]]] = {
    "torque_twice": lambda _: {"kind": "twice"},
    "torque_minus": lambda _: {"kind": "minus"},
    "torque_more": lambda chance: {"kind": "more", "torque": chance.choice([-1.0, 1.0]) * chance.uniform(1.0, 8.0)},
    "torque_stuck": lambda _: {"kind": "stuck"},
}
_TWIN: Final = "twin"
FURTHER: Final = (*_TORQUES, _TWIN)
"""Faults in the place of another in a part of the scenes, drawn by themselves, so that every other seed keeps its own:
another torque acts than the commanded one, and is read; a second sender has the COB-ID of the TPDO."""
_FURTHER_SHARE: Final = 0.15
_IN_TURN: Final = "losses_in_turn"
NAMES: Final = (*_ON_THE_BUS, *_OF_THE_BUS, *(name for name in _TRIGGERED if name != _TWIN), _IN_TURN)
"""All faults; the last one takes the axes of a group in turn."""


def with_fault(scene: TruthScene) -> TruthScene:
    """Returns a scene with one fault, begun at a random time, the bus otherwise ideal; a group may have two buses."""
    chance = np.random.default_rng([scene.seed, 20])
    values = dict(scene.values)
    simulation = values["simulation"] = dict(values["simulation"])
    simulation.pop("bus", None)
    tags = {tag for tag in scene.tags if not tag.startswith("timing:")}
    names = NAMES if "groups" in values else NAMES[:-1]
    if "drive:read_none" in tags:
        names = tuple(name for name in names if name != "foreign_rpdo")
    name = _further(scene.seed, tags) or names[int(chance.integers(len(names)))]
    begin = float(chance.uniform(_LATE, 0.8)) * scene.duration
    period = 1.0 / values["bus"]["rate"]
    values["bus"] = {**values["bus"], "channel": f"truth {scene.seed}"}  # on which another node may be
    tags.add(f"fault:{name}")
    effects = _effects(name, begin, period, chance)
    if effects:
        simulation["bus"] = _plain(effects)
    if name in _TORQUES:
        fault = {"at": begin, **_TORQUES[name](chance), "shown": "actual" if "drive:read_actual" in tags else "both"}
        simulation["drive"] = {**simulation.get("drive", {}), "fault": [_plain(fault)]}
    if "group:coupled_handles" in tags and chance.random() < 0.5 and name not in _TRIGGERED:
        tags.add("two_buses")
        first, second = values["axes"]
        values["bus"] = [{"name": "left", **values["bus"]}, {"name": "right", "channel": f"{scene.seed} right"}]
        values["axes"] = [{**first, "bus": "left"}, {**second, "bus": "right", "node_id": 1}]
    return replace(scene, values=values, tags=frozenset(tags), begin=begin)


def _further(seed: int, tags: set[str]) -> str:
    """Returns one of `FURTHER`, in a part of the scenes; what no frame shows is left out."""
    chance = np.random.default_rng([seed, 51])
    is_drawn, names = chance.random() < _FURTHER_SHARE, (_TWIN,) if "drive:read_none" in tags else FURTHER
    return names[int(chance.integers(len(names)))] if is_drawn else ""


def _effects(name: str, begin: float, period: float, chance: np.random.Generator) -> dict[str, Any]:
    during = [{"begin": begin, "duration": _FOR_GOOD}]
    if name in _ON_THE_BUS:
        found = _ON_THE_BUS[name](period, chance)
        if "ids" in found and _TPDO in found["ids"] and chance.random() < 0.5:
            found["ids"] = [*found["ids"], _TPDO + 1]
        return {**found, "during": during}
    once = {"begin": begin, "duration": chance.uniform(0.5, 60.0) * period}
    if name == _IN_TURN:
        turn = {"begin": begin, "duration": 1.2 * period, "every": 2.0 * period}
        return {"drop": 1.0, "direction": "to_master", "ids": [_TPDO], "during": [turn]}
    if name == "stall_often":
        return {"stall": [{**once, "every": 1.2 * once["duration"]}]}
    if name == "bus_off_for_good":
        return {"bus_off": during}
    return {name: [once]} if name in ("freeze", "stall", "bus_off") else {}


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_plain(inner) for inner in value]
    return float(f"{value:.4g}") if isinstance(value, float) else value


class FaultWatch:
    """Triggers what is no effect of the bus, and notes since when no drive gives a torque.

    Args:
        experiment: Not run yet.
        scene: With its fault.
    """

    def __init__(self, experiment: Experiment, scene: TruthScene) -> None:
        self._experiment, self._seed = experiment, scene.seed
        name = next((tag.partition(":")[2] for tag in scene.tags if tag.startswith("fault:")), "")
        self._trigger = _TRIGGERED.get(name)
        self._at = round(scene.begin / experiment.rig.bus.sample_time)
        self._period = experiment.rig.bus.sample_time_ns
        self._first: int | None = None
        self._zero_since: int | None = None
        self._drives = experiment.far_side.drives if experiment.far_side else ()
        clock: Any = experiment.clock
        far_sides = (*clock._far_sides, self)  # noqa: SLF001 - asked after the drives at each instant
        VirtualClock.__init__(clock, far_sides, clock.now())
        self.drive: Any = self._drives[0]

    def next_due(self) -> int:
        """Has nothing to do by itself (a `SimulatedPeer`)."""
        return NEVER

    def process(self, now: int) -> None:
        """Notes since when the torque of all drives is zero."""
        if any(drive.torque for drive in self._drives):
            self._zero_since = None
        elif self._zero_since is None:
            self._zero_since = now

    def __call__(self, cycles: int) -> None:
        """Called behind every cycle."""
        if self._first is None:
            self._first = self._experiment.clock.now() - cycles * self._period
        if cycles == self._at and self._trigger is not None:
            self._trigger(self)

    def syncs_to_zero(self) -> int:
        """Returns the sample times from the fault until no drive gave a torque any more, for good."""
        now = self._experiment.clock.now()
        begin = (self._first or 0) + self._at * self._period
        return math.ceil(max(0, (now if self._zero_since is None else self._zero_since) - begin) / self._period)

    def send(self, can_id: int, *data: int) -> None:
        """Sends a frame as another device on the first bus, which drives and master hear."""
        channel = str(self._experiment.scene.buses[0].parameters.channel)
        with can.Bus(channel, interface="virtual") as other:
            other.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    def jump(self) -> None:
        """Turns the highest bit but one of every position of the first axis from now on."""
        link: Any = self._experiment.rig.drives[0].link
        link._bus = JumpingBus(link._bus)  # noqa: SLF001 - in between

    def answer_twice(self) -> None:
        """Lets a second sender answer for the first drive from now on, a random distance away."""
        chance = np.random.default_rng([self._seed, 48])
        link: Any = self._experiment.rig.drives[0].link
        moved = int(chance.choice([-1, 1])) * int(10.0 ** chance.uniform(0.0, 3.0))
        link._bus = TwinBus(link._bus, _TPDO, moved, is_first=chance.random() < 0.5)  # noqa: SLF001 - in between

    def break_controller(self) -> None:
        """Makes torques of the first controller that are no number."""
        cycle: Any = self._experiment.cycle
        of: Any = cycle.ports[0].controller
        step = of.step

        def broken(*arguments: Any) -> Any:
            found = step(*arguments)
            if hasattr(found, "torques"):
                return found._replace(torques=(math.nan,) * len(found.torques))
            return found._replace(torque=math.nan)

        of.step = broken


class JumpingBus:
    """A bus whose first drive seems to jump: the highest bit but one of each of its positions is turned."""

    def __init__(self, bus: can.BusABC) -> None:
        self.send, self._recv = bus.send, bus.recv

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Returns the next frame, changed where it is the TPDO."""
        message = self._recv(timeout)
        if message is not None and message.arbitration_id == _TPDO:
            message.data[5] ^= 0x40
        return message


class TwinBus:
    """A bus on which a second sender answers each SYNC too, with the same TPDO and another position.

    Args:
        bus: The bus.
        cob_id: Of the TPDO.
        moved: How far its position is off, in counts.
        is_first: Whether it answers before the drive.

    Attributes:
        sent: Number of its frames.
    """

    def __init__(self, bus: can.BusABC, cob_id: int, moved: int, *, is_first: bool) -> None:
        self.send, self._recv = bus.send, bus.recv
        self._cob_id, self._moved, self._is_first = cob_id, moved, is_first
        self._waiting: list[can.Message] = []
        self.sent = 0

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Returns the next frame."""
        if self._waiting:
            return self._waiting.pop()
        message = self._recv(timeout)
        if message is None or message.arbitration_id != self._cob_id:
            return message
        self.sent += 1
        twin = copy.copy(message)
        twin.data = bytearray(message.data)
        position = int.from_bytes(twin.data[2:6], "little", signed=True) + self._moved
        twin.data[2:6] = position.to_bytes(4, "little", signed=True)
        first, second = (twin, message) if self._is_first else (message, twin)
        self._waiting.append(second)
        return first
