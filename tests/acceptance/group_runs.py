"""Scenes with groups, run over the whole CAN path, and what their logs say."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from canhaptic.cycle import run
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.scene.build import Experiment, build
from canhaptic.scene.load import load_scene

REPOSITORY = Path(__file__).resolve().parents[2]
AXES = {"five_bar_sphere": ("left", "right"), "xy_box": ("x", "y"), "two_handles": ("first", "second")}
GROUP = {"five_bar_sphere": "stylus", "xy_box": "stage", "two_handles": "coupling"}


def run_config(name: str, cycles: int, log: Path | None = None, overrides: Sequence[str] = (), bus: Path | None = None):
    """Runs a shipped scene in lock-step and returns it with its account."""
    scene = load_scene(REPOSITORY / "configs" / f"{name}.yaml", overrides)
    with build(scene, "free", log, bus) as experiment:
        run(experiment.cycle, cycles)
    return experiment


@contextmanager
def logged(
    name: str, cycles: int, folder: Path, overrides: Sequence[str] = ()
) -> Iterator[tuple[Experiment, EnergyLog]]:
    """Runs a shipped scene and opens its log."""
    path = folder / "run.h5"
    experiment = run_config(name, cycles, path, overrides)
    with EnergyLog.open(path) as log:
        yield experiment, log


def encoder_bound(port: Any, count: float) -> float:
    """The bound of trap 12: (count / 2) (TV(tau) + |tau_end|), the jump from 0 to the first torque included."""
    torque = np.concatenate([[0.0], port["torque_applied"]])
    return 0.5 * count * (np.abs(np.diff(torque)).sum() + abs(torque[-1]))


def identity(port: Any) -> np.ndarray:
    """How far each row is from the identity of `canhaptic.control.balance`, relative to its largest term."""
    before = np.concatenate([[0.0], port["h_s"][:-1]])
    terms = [port["h_s"], before, port["h_r"], port["h_i"], port["gen"], port["h_pas"], port["deficit"], port["leak"]]
    signs = (1, -1, 1, -1, -1, 1, -1, 1)
    total = sum(sign * term for sign, term in zip(signs, terms, strict=True))
    return np.abs(total) / np.maximum(1e-12, np.max(np.abs(terms), axis=0))
