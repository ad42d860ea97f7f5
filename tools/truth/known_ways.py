"""Ways on which certified torques once gave out energy, as scenes with random hands: declared, left out, false.

Each names something of a real hold that the proof of an ideal one leaves out (`tools/attack/holes.py` attacks the same
on a plant of its own). Three scenes each: the key that closes it is declared as it is; it is left out, so that it
follows from the scene; it is declared falsely, as ideal. A way is closed where no hand gets energy out of the first
two. No account can notice every false declaration: the last columns have the runs that gave energy out, and those of
them whose account did not say yes.
"""

import copy
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import numpy as np

from tools.truth.judge import FINE, ROUNDING, Outcome, judged
from tools.truth.scenes import TruthScene

_MASS, _PULL = 0.25, 5.0


class Way(NamedTuple):
    """One way out, at one loop."""

    name: str
    what: str
    rate: float  # of the bus [Hz]
    rpdo: str
    stiffness: float  # of the wall [N/m]
    declared: Mapping[str, Any]  # keys of `passivity`, or of the axis after a dot
    false: Mapping[str, Any]  # what takes their place
    simulation: Mapping[str, Any] = {}
    damping: float = 0.0  # of the wall [N*s/m]
    device: float = 0.1  # damping of the device [N*s/m]
    push: float = 20.0  # of the hand, at most [N]


def _lag(time: float) -> dict[str, Any]:
    return {"effects": [{"type": "current_loop", "time_constant": time}]}


def _sync(**effects: Any) -> dict[str, Any]:
    return {"bus": {**effects, "ids": [0x80], "direction": "to_drive"}}


_LATE: Final = {"begin": 0.0, "duration": 0.012, "every": 0.08}
_DRY: Final = {"effects": [{"type": "coulomb_friction", "kinetic": 2.0, "static": 2.0}]}
_SHAFT: Final = {
    "effects": [{"type": "shaft_compliance", "stiffness": 5000.0, "damping": 1.0, "load_mass": 0.126}],
    "plant": {"mass": 0.1},
}
WAYS: Final = (
    Way("A", "limit of 2.5 N, 100 Hz", 100, "synchronous", 2000.0, {".torque_limit": 2.5}, {".torque_limit": 30.0},
        {"drive": {"torque_limit": 2.5}}),
    Way("A", "limit of 1 N, 40 Hz", 40, "synchronous", 2000.0, {".torque_limit": 1.0}, {".torque_limit": 30.0},
        {"drive": {"torque_limit": 1.0}}),
    Way("A", "rate limit of 50 N/s, 40 Hz", 40, "synchronous", 2000.0, {".torque_rate_limit": 50.0},
        {".torque_rate_limit": 50.0}),
    Way("K", "damped wall, pushed, 100 Hz", 100, "event", 2000.0, {"hand_push": 60.0}, {"hand_push": 0.0},
        damping=20.0, push=60.0),
    Way("K", "the same one sample late", 100, "synchronous", 2000.0, {"hand_push": 60.0}, {"hand_push": 0.0},
        damping=20.0, push=60.0),
    Way("C", "SYNC up to 2 % late, 100 Hz", 100, "synchronous", 2000.0, {"sync_jitter": 0.02}, {"sync_jitter": 0.0},
        _sync(jitter=2e-4)),
    Way("C", "SYNC up to 10 % late, 100 Hz", 100, "synchronous", 2000.0, {"sync_jitter": 0.1}, {"sync_jitter": 0.0},
        _sync(jitter=1e-3)),
    Way("C", "one SYNC in eight 0.49 T late, 100 Hz", 100, "synchronous", 2000.0, {"sync_jitter": 0.49},
        {"sync_jitter": 0.0}, _sync(delay=4.9e-3, during=[_LATE])),
    Way("D", "event RPDO with wire time, 1 kHz", 1000, "event", 5000.0, {"torque_window": 6e-4},
        {"torque_window": 1e-9}, {"bus": {"wire_time": True}}),
    Way("D", "RPDO 0.3 T late, 100 Hz", 100, "event", 1000.0, {"torque_window": 7e-3}, {"torque_window": 1e-9},
        {"bus": {"delay": 1.5e-3}}),
    Way("F", "current loop of 100 us, 1 kHz", 1000, "synchronous", 5000.0, {"current_lag": 1e-4}, {"current_lag": 1e-9},
        _lag(1e-4)),
    Way("F", "current loop of 300 us, 1 kHz", 1000, "synchronous", 1e4, {"current_lag": 3e-4}, {"current_lag": 1e-9},
        _lag(3e-4)),
    Way("U", "damping of 2 N s/m, 100 Hz", 100, "event", 2000.0, {"device_damping_bound": 2.0},
        {"device_damping_bound": 0.0}, device=2.0),
    Way("B", "dry friction of 2 N, 100 Hz", 100, "event", 2000.0, {"device_friction_bound": 2.0},
        {"device_friction_bound": 0.0}, _DRY),
    Way("G", "rotor of 0.1 kg on a shaft, 100 Hz", 100, "event", 200.0, {"moving_mass": 0.1}, {"moving_mass": 0.226},
        _SHAFT),
)  # fmt: skip
_NEEDED: Final = frozenset(("device_damping_bound", "device_friction_bound", "moving_mass", ".torque_limit"))
"""Keys that a scene cannot leave out, or that do not follow from it."""


def scene_of(way: Way, hand: int, declares: str) -> TruthScene:
    """Returns a way out with a random hand.

    Args:
        way: One of `WAYS`.
        hand: Its number.
        declares: "declared", "left out" or "false".
    """
    given = {"declared": way.declared, "left out": {}, "false": way.false}[declares]
    simulation: dict[str, Any] = copy.deepcopy(dict(way.simulation))
    plant = {"mass": _MASS, "damping": way.device, "initial_position": 0.004, **simulation.pop("plant", {})}
    drive = {"objects": {"0x6502": 512}, **simulation.pop("drive", {})}
    passivity: dict[str, Any] = {
        "algorithm": "guarded", "moving_mass": plant["mass"], "device_damping_bound": way.device, "hand_force": _PULL
    }  # fmt: skip
    axis: dict[str, Any] = {
        "name": "handle", "node_id": 1, "eds": "cia402_servo.eds", "unit": "m", "counts_per_unit": 1e7,
        "rated_torque": 20.0, "torque_limit": 30.0,
    }  # fmt: skip
    for key, value in given.items():
        if key.startswith("."):
            axis[key[1:]] = value
        else:
            passivity[key] = value
    values: dict[str, Any] = {
        "bus": {"rate": way.rate, "rpdo": way.rpdo},
        "duration": min(1.5, 600.0 / way.rate),
        "axes": [axis],
        "simulation": {"seed": hand, "drive": drive, "plant": plant, "user": _hand(way, hand), **simulation},
        "environment": {
            "type": "spring_damper_wall", "stiffness": way.stiffness, "damping": way.damping, "position": 0.0
        },
        "passivity": passivity,
    }  # fmt: skip
    tags = {"algorithm:guarded", f"way:{way.name}"} | ({"false:way"} if declares == "false" else set())
    return TruthScene(hand, values, frozenset(tags), (1,), values["duration"])


def _hand(way: Way, hand: int) -> dict[str, Any]:
    """Returns a hand that presses with at most a force, or one that taps or shakes."""
    random = np.random.default_rng([hand, 29])
    found: dict[str, Any] = {"damping": float(random.uniform(0.0, 6.0))}
    if random.random() < 0.6:
        found["push"] = float(random.uniform(-way.push, 0.0))
    if "push" not in found or random.random() < 0.6:
        found["stiffness"] = float(10.0 ** random.uniform(1.8, 3.5))
        frequency = float(10.0 ** random.uniform(0.0, np.log10(0.3 * min(way.rate, 200.0))))
        amplitude = float(10.0 ** random.uniform(-3.0, -1.3))
        found["motion"] = {"type": "sinusoid", "amplitude": amplitude, "frequency": frequency}
    return found


def row_of(way: Way, hands: int) -> dict[str, Any]:
    """Returns the row of a way out: the least true sums [J] of all hands, and what a run notices of what is false.

    The force of each hand is declared as it was.
    """
    declared, left_out, false = [], [], []
    for hand in range(hands):
        scene, outcome = judged(scene_of(way, hand, "declared"))
        declared.append(outcome)
        left_out += [judged(_with_hand_of(scene, scene_of(way, hand, "left out")))[1]] if _can_be_left_out(way) else []
        false.append(judged(_with_hand_of(scene, scene_of(way, hand, "false")))[1])
    out = [outcome for outcome in false if outcome.least < -ROUNDING]
    due = [outcome for outcome in declared + left_out if outcome.open_share < FINE]
    return {
        "": way.name,
        "loop": way.what,
        "by": ", ".join(key.lstrip(".") for key in way.declared),
        "declared [J]": min(outcome.least for outcome in declared),
        "left out [J]": min((outcome.least for outcome in left_out), default=None),
        "yes": sum(map(_says_yes, due)),
        "of": len(due),
        "false claims": sum(bool(outcome.false_claims) for outcome in declared + left_out),
        "declared falsely [J]": min(outcome.least for outcome in false),
        "gave out": len(out),
        "noticed": sum(not _says_yes(outcome) for outcome in out),
    }


def _says_yes(outcome: Outcome) -> bool:
    return "yes" in (outcome.verdict, outcome.at_handle)


def _can_be_left_out(way: Way) -> bool:
    return not _NEEDED & way.declared.keys()


def _with_hand_of(raised: TruthScene, scene: TruthScene) -> TruthScene:
    scene.passivity["hand_force"] = raised.passivity["hand_force"]
    return scene


def is_closed(row: Mapping[str, Any]) -> bool:
    """Whether no hand got energy out where nothing false was declared, and nothing false was claimed."""
    least = min(row["declared [J]"], 0.0 if row["left out [J]"] is None else row["left out [J]"])
    return bool(least >= -ROUNDING and not row["false claims"])
