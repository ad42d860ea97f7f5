"""Be the program: a wall that shakes when it is struck, asked for torque by torque. 300 lines with `canopen` by hand."""

import math
import sys
import tempfile
from pathlib import Path

import canhaptic

SCENE = Path(__file__).resolve().parents[1] / "configs" / "demo.yaml"
WALL = -0.05  # [m] solid below
STIFFNESS, DAMPING = 400.0, 4.0  # [N/m], [N*s/m]
TAP, TONE, FADE = 40.0, 60.0, 0.05  # force per speed of the stroke [N*s/m], frequency [Hz], time [s]


def main(folder: Path) -> None:
    """Run for 4 s; say what the guard let pass, and what it took away."""
    struck, speed, cut = -math.inf, 0.0, 0
    with canhaptic.open_rig(SCENE, duration=4.0, energy_log=folder / "run.h5", bus_log=folder / "run.log") as rig:
        for sample in rig:
            handle = sample["handle"]
            depth, now = WALL - handle.position, handle.sync_index * rig.sample_time
            cut += rig["handle"].limited_by not in ("", "start")
            if depth <= 0.0:
                struck = -math.inf
                continue  # not set: no torque
            if struck == -math.inf:
                struck, speed = now, -handle.velocity
            since = now - struck
            ring = TAP * speed * math.exp(-since / FADE) * math.sin(2.0 * math.pi * TONE * since)
            rig["handle"].torque = STIFFNESS * depth - DAMPING * handle.velocity + ring
    account = rig.account["handle"]
    print(f"passive: {account.verdict}; in {1e3 * account.energy_in:.1f} mJ, out {1e3 * account.energy_out:.1f} mJ")
    print(f"cut by the guard in {cut} of {account.name}'s {rig.account.raw['cycles']} turns")
    print(f"logs: {', '.join(sorted(path.name for path in folder.iterdir()))}")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        main(Path(sys.argv[1] if len(sys.argv) > 1 else temporary))
