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
    taken_in = np.cumsum(handle["h_i"])
    inside = np.flatnonzero(handle["position"] < -0.05)
