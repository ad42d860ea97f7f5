"""`inspect --why` and `--why --try`: why a run buzzes, and the same hand in the twin with the value that was found."""

import argparse
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypedDict
from warnings import catch_warnings

import numpy as np
import yaml

from canhaptic.audit.why.causes import Known, Why, is_worth_a_line, known_of, why
from canhaptic.audit.why.ripple import motion_of, ripple_force
from canhaptic.errors import CanHapticError, InputError
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.scene.load import load_scene
from canhaptic.scene.models import Scene
from canhaptic.view.buzz_lines import buzz_line
from canhaptic.view.terminal import write_note

if TYPE_CHECKING:
    from canhaptic.audit.inspection import Inspection

_LONGEST: Final = 60.0  # of a log that `run` reads at its end [s]
_GRIP: Final = {"m": (300.0, 3.0), "rad": (1.0, 0.01)}
"""Stiffness and damping of the hand in the twin of a real log, by the unit of the axis."""
_BUZZES_AS: Final = 0.33
"""Least share of the log's ripple that the twin must show."""
_CALMER: Final = 0.5


class Trial(TypedDict):
    """Outcome of a key changed in the twin; ripples are rms forces [N or N*m]."""

    key: str
    value: float | str
    log: float
    twin: float
    changed: float
    in_model: bool  # whether the twin buzzes as the log does
    text: str


def add_why(log: EnergyLog, result: "Inspection", arguments: argparse.Namespace) -> None:
    """Add what trembles to the summary of a log, and with `--try` the outcome of the first value of each axis.

    Raises:
        InputError: The scene of the log is needed and cannot be read.
    """
    from canhaptic.audit.inspection import rows_between  # a run needs neither
    from canhaptic.audit.recompute import scene_of

    scene = None
    try:
        with catch_warnings(action="ignore"):  # the run has shown them
            scene = scene_of(log, arguments.config, allow_code=arguments.allow_code)
    except CanHapticError:
        if arguments.try_:
            raise
    rows = rows_between(log, arguments.start, arguments.stop)
    if not (arguments.why or arguments.try_):  # a page shows it unasked: of a long log its end
        rows = slice(max(rows.start, rows.stop - round(_LONGEST / log.sample_time)), rows.stop)
    found = why(log, scene, rows)
    result["why"] = found
    if arguments.try_ and scene is not None:
        result["trials"] = trials(log, scene, found, allow_code=arguments.allow_code)


def note_buzz(path: Path, scene: Scene) -> None:
    """Note on standard error that the run of a log buzzed; nothing where it did not.

    Raises:
        CanHapticError: The log cannot be read.
    """
    with EnergyLog.open(path) as log:
        last = max(0, log.rows - round(_LONGEST / log.sample_time))
        for name, of in why(log, scene, slice(last, log.rows)).items():
            if not is_worth_a_line(of):
                continue
            text = buzz_line(name, of, log.ports[name].unit("position"))
            write_note(f"  {text}; `canhaptic inspect {path} --why` says why")


def trials(log: EnergyLog, scene: Scene, found: Mapping[str, Why], *, allow_code: bool = False) -> dict[str, Trial]:
    """Return for each axis that trembles what its first value does in the twin."""
    done = {}
    for name, of in found.items():
        cause = next((cause for cause in of["causes"] if cause["value"] is not None), None)
        if cause is not None and cause["value"] is not None:
            done[name] = trial(log, scene, name, cause["key"], cause["value"], allow_code=allow_code)
    return done


def trial(log: EnergyLog, scene: Scene, name: str, key: str, value: float | str, *, allow_code: bool = False) -> Trial:
    """Simulate the twin of a log twice, as it is and with a key changed.

    A simulated run has its own hand. The hand of a real log is where the grip must have been for the handle to move as
    it did without the ripple: position and torque of the log, both smoothed, through the grip.
    """
    known, rows = known_of(scene, name), slice(0, log.rows)
    before = ripple_force(motion_of(log, name, rows), known.weight)
    with tempfile.TemporaryDirectory(prefix="canhaptic-try-") as folder:
        source = _twin(log, scene, known, Path(folder))
        as_is, changed = (
            _simulated(source, list(scene.overrides) + more, name, log, known, Path(folder), allow_code=allow_code)
            for more in ([], [f"{key}={value}"])
        )
    in_model = as_is >= _BUZZES_AS * before
    if not in_model:
        text = "the twin does not buzz as the log does: the cause is not in the model"
    elif changed <= _CALMER * as_is:
        text = "the value calms it"
    else:
        text = "the value does not calm it: see the next cause"
    return {
        "key": key, "value": value, "log": before, "twin": as_is, "changed": changed, "in_model": in_model,
        "text": text,
    }  # fmt: skip


def _simulated(
    source: Path, overrides: list[str], name: str, log: EnergyLog, known: Known, folder: Path, *, allow_code: bool
) -> float:
    """Return the rms force of the ripple in a simulated run; infinite where it ends early."""
    from canhaptic.simulation import simulate

    with catch_warnings(action="ignore"):
        scene = load_scene(source, overrides, allow_code=allow_code)
        duration = log.rows * log.sample_time
        result = simulate(scene, duration=duration, progress=False, check=False)
    with result.log() as made:
        if made.rows < 2:
            return float("inf")
        force = ripple_force(motion_of(made, name), known.weight)
    return force if result.error is None else max(force, float("inf"))


def _twin(log: EnergyLog, scene: Scene, known: Known, folder: Path) -> Path:
    """Return the file of the twin: the scene itself where it is simulated, else one with the hand of the log."""
    if scene.simulated:
        return Path(scene.source)
    plain = yaml.safe_load(scene.text)
    if not isinstance(plain, dict) or len(scene.axes) != 1:
        raise InputError(f"{scene.source}: --try needs a scene with `simulation`, or with one axis alone")
    axis = scene.axes[0]
    stiffness, damping = _GRIP[known.unit]
    motion = motion_of(log, known.axis)
    force = np.zeros_like(motion.position) if motion.torque is None else -motion.torque
    size = max(1, round(0.1 / motion.period))
    hand = motion.position + force / stiffness
    smooth = np.convolve(np.pad(hand, size, "edge"), np.hanning(2 * size + 1) / size, "valid")
    lines = [f"{n * motion.period:.6f},{x:.9g}" for n, x in enumerate(smooth)]
    (folder / "hand.csv").write_text("\n".join(["time,position", *lines]), encoding="utf-8")
    plant = {"mass": known.weight, "damping": axis.loop.device_damping or 0.0, "initial_position": float(smooth[0])}
    user = {"stiffness": stiffness, "damping": damping, "motion": {"type": "recorded", "file": "hand.csv"}}
    plain["bus"] = {**plain["bus"], "interface": "virtual"}
    plain["bus"].pop("channel", None)
    plain["simulation"] = {"plant": plant, "user": user}
    plain["axes"][0]["eds"] = str(Path(axis.parameters.eds).resolve())
    path = folder / "twin.yaml"
    path.write_text(yaml.safe_dump(plain, sort_keys=False), encoding="utf-8")
    return path
