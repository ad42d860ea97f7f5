"""Random admittance displays over CAN: drive, sensor, mass, hand and rate are drawn, and every declaration is true."""

import math
from typing import Any, Final

from tools.chance import Chance
from tools.truth.scenes import TruthScene

_SHARE: Final = 4
_RATES: Final = (500, 1000)


def with_display(scene: TruthScene) -> TruthScene:
    """Returns a display in place of every fourth scene."""
    return random_display_scene(scene.seed) if scene.seed % _SHARE == _SHARE - 1 else scene


def random_display_scene(seed: int) -> TruthScene:
    """Returns the display of a seed."""
    chance = Chance(seed, 53)
    decades, one_of = chance.decades, chance.one_of
    mass, bandwidth, rate = decades(0.5, 3.0), one_of((25.0, 50.0, 100.0)), one_of(_RATES)
    gain = 2.0 * math.pi * bandwidth * mass
    mode, algorithm = one_of(("velocity", "position")), one_of(("guarded", "guarded", "guarded", "unprotected"))
    noise = decades(1e-3, 0.02)
    guarded = {
        "drive_mass": 1.05 * mass, "loop_gain": 1.05 * gain, "energy_allowance": one_of((1e-4, 1e-3, 1e-2)),
    }  # fmt: skip
    values: dict[str, Any] = {
        "bus": {"rate": rate, "rpdo": "synchronous"},
        "duration": decades(0.3, 1.2),
        "axes": [_axis(mode, noise)],
        "environment": {
            "type": "virtual_mass", "mass": decades(1.2, 6.0) * mass, "damping": decades(1.0, 20.0),
            "lower_wall": -decades(0.02, 0.1),
        },
        "passivity": {"algorithm": algorithm, **(guarded if algorithm == "guarded" else {})},
        "simulation": {
            "seed": seed % 1_000_000,
            "plant": {"mass": mass, "damping": decades(1.0, 10.0)},
            "admittance": {
                "loop": {"gain": gain},
                "grip": {
                    "mass": decades(0.1, 1.0), "stiffness": decades(5e3, 5e4), "damping": decades(5.0, 30.0),
                },
                "sensor": {"noise": noise},
            },
            "user": {
                "stiffness": decades(100.0, 400.0), "damping": decades(5.0, 20.0),
                "motion": {"type": "sinusoid", "amplitude": decades(0.03, 0.15), "frequency": decades(0.4, 2.0)},
            },
        },
    }  # fmt: skip
    tags = {f"display:{mode}", f"algorithm:{algorithm}", f"rate:{rate}"}
    return TruthScene(seed, values, frozenset(tags), (1,), values["duration"])


def _axis(mode: str, noise: float) -> dict[str, Any]:
    """Returns an axis whose slew of the force and acceleration of the handle are over-estimates."""
    force = {"object": "0x2205.1", "per_count": 0.01, "range": 300.0, "slew": 2e4, "error": 0.01 + 6.0 * noise}
    admittance = {
        "mode": mode, "acceleration_limit": 50.0, "handle_acceleration": 200.0, "position_low": -0.3,
        "position_high": 0.3, "force": force,
    }  # fmt: skip
    return {
        "name": "handle", "node_id": 1, "eds": "cia402_admittance.eds", "unit": "m", "counts_per_unit": 1e6,
        "rated_torque": 100.0, "torque_limit": 200.0, "speed_limit": 2.0, "admittance": admittance,
    }  # fmt: skip
