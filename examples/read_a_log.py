"""Read quantities and contacts from a log."""

from pathlib import Path

import numpy as np

import canhaptic

CONFIGS = Path(__file__).resolve().parents[1] / "configs"

path = Path("read.h5")
path.unlink(missing_ok=True)
canhaptic.simulate(CONFIGS / "demo.yaml", duration=4.0).save(path)
with canhaptic.EnergyLog.open(path) as log:
    handle = log.ports["handle"]
    print(f"{log.rows} rows, {log.status}; quantities:", ", ".join(list(handle)[:6]), "...")
    taken_in = np.cumsum(handle["interaction"])
    inside = np.flatnonzero(handle["position"] < -0.05)
    print(f"in the wall for {len(inside) * log.sample_time:.3f} s, first at {log.time[inside[0]]:.3f} s")
    print(f"taken in {taken_in[-1]:.5f} J [{handle.unit('interaction')}], never below {min(0.0, taken_in.min()):.1e} J")
