"""A loop with `time.sleep` behind a wall that the rig renders at 1 kHz: a lift goes up and down under the hand.

Alone it meets the simulated rig in virtual time; with `loopback`, `canhaptic run configs/far_world.yaml --pace real`.
"""

import math
import sys
import time
from pathlib import Path

import canhaptic

RIG = Path(__file__).resolve().parents[1] / "configs" / "far_world.yaml"

if __name__ == "__main__":
    where, deepest, now = (sys.argv[1:] or ["virtual"])[0], 0.0, 0.0
    with canhaptic.World(where, scene=RIG) as world:
        for hand in world:
            now += 1 / 60
            floor, speed = 0.03 - 0.01 * math.sin(now), -0.01 * math.cos(now)
            world["handle"].wall(at=floor, speed=speed, stiffness=1500.0, pushes="-", damping=5.0)
            deepest = max(deepest, hand["handle"].position - floor)
            if where != "virtual":
                time.sleep(1 / 60)  # a frame of 17 ms; the rig goes on at its own rate
    print(f"{1e3 * deepest:.1f} mm deep", "" if world.result is None else world.result["ports"]["handle"]["verdict"])
