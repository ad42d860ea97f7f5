"""Recomputation of a log: its controllers get the logged inputs again, and every output must agree bit for bit.

The scene of the run is found by the hash of its configuration, which for the log of an earlier release is that of the
names and keys of that release. `tools/convert_scene.py` converts a scene of an earlier release to those of this one.
"""

import struct
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple, TypedDict, get_args

import numpy as np

from canhaptic.control.balance import Certificate, EnergyBalance
from canhaptic.control.multi_axis.group_controller import GroupedControllers
from canhaptic.control.verdict import ACTIVE_AT_HANDLE, ACTIVE_AT_MOTOR
from canhaptic.errors import InputError
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.meters import limits_of
from canhaptic.signals import Sample

if TYPE_CHECKING:
    from canhaptic.scene.models import Scene

_INPUTS: Final = ("position", "torque_applied", "fresh")
_OUTPUTS: Final = tuple("torque_command" if name == "torque" else name for name in EnergyBalance._fields)
_CERTIFICATE: Final = EnergyBalance._fields.index("certificate")
_NONE: Final = Certificate.NONE.value
_ROUNDING: Final = 1e-12
"""Largest accepted difference between a recomputed and a logged sum of energies [J]."""
_LAST_OLD_FORMAT: Final = 2
"""Newest format of the logs of earlier releases."""
_BLOCK: Final = 65_536  # rows held in memory at a time
_ALL: Final = struct.Struct(f"{len(_OUTPUTS)}d")
_ONE: Final = struct.Struct("d")


class Mismatch(NamedTuple):
    """The first output that differs."""

    port: str
    cycle: int
    quantity: str
    logged: float
    recomputed: float


class Recomputed(TypedDict):
    """Outcome of the recomputation of a port."""

    port: str
    mismatch: dict[str, str | int | float] | None  # fields of the `Mismatch`; None: every output is equal
    rows: int  # that were recomputed: up to the first missing one, or to a skipped SYNC whose length matters
    unchecked_rows: int  # after these
    missing_rows: int  # that the log lost


def recompute(log: EnergyLog, axes: Sequence[str], controllers: GroupedControllers) -> list[Mismatch]:
    """Return the first logged output of each axis and group that differs from the recomputed one.

    The computation ends at the first missing row, because the inputs there are unknown.

    Args:
        log: An open energy log that holds the run from its first cycle.
        axes: Names of the axes, in the order of the rig.
        controllers: Controllers built from the scene of the run, in their initial state.
    """
    found: dict[str, Mismatch] = {}
    names = (*axes, *(group.name for group in controllers.groups))
    inputs = [logged_rows(log, name, _INPUTS) for name in axes]
    outputs = [logged_rows(log, name, _OUTPUTS) for name in names]
    rows = zip(periods_of(log), zip(*inputs, strict=True), zip(*outputs, strict=True), strict=False)
    programs = [(program, efforts_asked(log, axes[axis])) for axis, program in controllers.programs]
    for row, (periods, seen, expected) in enumerate(rows):
        controllers.lasted(periods)
        for program, asked in programs:
            program.ask(-next(asked))
        samples = [Sample(row, position, torque, 0, fresh=bool(fresh)) for position, torque, fresh in seen]
        balances = [*controllers.step(samples), *(group.balance.account for group in controllers.groups)]
        for name, balance, logged in zip(names, balances, expected, strict=True):
            if logged[_CERTIFICATE] == _NONE:  # withdrawn for the length of a hold, which is no input
                balance = balance._replace(certificate=_NONE)
            if name not in found and _ALL.pack(*balance) != _ALL.pack(*logged):
                pairs = enumerate(zip(balance, logged, strict=True))
                number = next(n for n, (now, was) in pairs if _ONE.pack(now) != _ONE.pack(was))
                cycle = int(log.timing["sync_index"][row])
                found[name] = Mismatch(name, cycle, _OUTPUTS[number], logged[number], balance[number])
    return list(found.values())


def activity_mismatch(log: EnergyLog, name: str) -> Mismatch | None:
    """Return the first row whose `active` disagrees with the energies and the resolution up to it; None if all agree.

    Rows after a missing one are not compared, nor logs of a format without this column.
    """
    port, rows = log.ports[name], rows_before_a_gap(log)
    limits = limits_of(log, name)
    if "active" not in port or limits is None or not rows:
        return None
    logged = port.read("active", 0, rows)
    most = np.cumsum(port.read("h_i", 0, rows), dtype=np.longdouble) + port.read("energy_resolution", 0, rows)
    at_handle = most + limits.power * limits.sample_time * (log.deadlines(0, rows) + 1)
    for bit, energy in ((ACTIVE_AT_MOTOR, most), (ACTIVE_AT_HANDLE, at_handle)):
        surely, likely = (np.maximum.accumulate(energy < limits.floor + more) for more in (-_ROUNDING, _ROUNDING))
        is_active = logged & bit > 0
        wrong = np.flatnonzero((surely & ~is_active) | (is_active & ~likely))
        if len(wrong):
            row = int(wrong[0])
            expected = logged[row] ^ bit
            return Mismatch(name, int(log.timing["sync_index"][row]), "active", float(logged[row]), float(expected))
    return None


def rows_before_a_gap(log: EnergyLog) -> int:
    """Return the number of rows before the first that the log lost."""
    lost = log.timing["dropped_before"]
    return int(np.argmax(lost > 0)) if lost.any() else log.rows


def periods_of(log: EnergyLog) -> list[int]:
    """Return the length of the hold that ended at each row [sample times], up to the first row that the log lost.

    It follows from the times of the SYNCs. For a late SYNC next to a skipped one it may be wrong by a sample time.
    """
    rows, period = rows_before_a_gap(log), log.sample_time_ns
    sent = log.deadlines(0, rows) * period + np.maximum(0, log.timing.read("wakeup_lateness", 0, rows))
    return [1, *np.maximum(1, (np.diff(sent) + period // 2) // period).tolist()][:rows]


def logged_rows(log: EnergyLog, port: str, columns: Sequence[str]) -> Iterator[tuple[float, ...]]:
    """Yield some columns of a port row by row, with one block of rows in memory at a time."""
    for start in range(0, log.rows, _BLOCK):
        block = (log.ports[port].read(column, start, start + _BLOCK).tolist() for column in columns)
        yield from zip(*block, strict=True)


def efforts_asked(log: EnergyLog, axis: str) -> Iterator[float]:
    """Yield the effort requested on an axis, row by row [N or N*m]: the negative torque."""
    return (effort for (effort,) in logged_rows(log, axis, ("effort_asked",)))


def recompute_all(log: EnergyLog, config: Path | None = None, *, allow_code: bool = False) -> list[Recomputed]:
    """Return the outcome for every port, recomputed with the controllers of the run's own scene.

    Args:
        log: An open energy log that holds the run from its first cycle.
        config: Scene file; by default the one that the log names.
        allow_code: Whether program files that the scene names may run.

    Raises:
        InputError: The scene cannot be read, differs from the scene of the run, or names user code that has changed.
    """
    from canhaptic.scene.parts import build_axis_controllers, build_axis_groups

    scene = scene_of(log, config, allow_code=allow_code)
    controllers = GroupedControllers(build_axis_controllers(scene), build_axis_groups(scene), dry_run=log.dry_run)
    axes = [axis.parameters.name for axis in scene.axes]
    found: dict[str, Mismatch | None] = {of.port: of for of in recompute(log, axes, controllers)}
    for name in log.ports:
        found.setdefault(name, activity_mismatch(log, name))
    whole, skips = rows_before_a_gap(log), np.flatnonzero(np.diff(log.deadlines()) > 1) + 1
    skipped = int(skips[0]) if len(skips) else log.rows
    results: list[Recomputed] = []
    for name in log.ports:
        mismatch, rows = found.get(name), whole
        if mismatch is not None and mismatch.cycle >= int(log.timing["sync_index"][min(skipped, log.rows - 1)]):
            mismatch, rows = None, min(rows, skipped)  # how long that hold lasted is not in the log
        values = None if mismatch is None else mismatch._asdict()
        unchecked = log.rows - rows
        results.append(
            {"port": name, "mismatch": values, "rows": rows, "unchecked_rows": unchecked, "missing_rows": log.dropped}
        )
    return results


def scene_of(log: EnergyLog, config: Path | None = None, *, allow_code: bool = False) -> "Scene":
    """Return the scene of the run that a log holds, with the overrides of that run.

    Args:
        log: An open energy log.
        config: Scene file; by default the one that the log names.
        allow_code: Whether program files that the scene names may run.

    Raises:
        InputError: The scene cannot be read, differs from the scene of the run, or names user code that has changed.
    """
    from canhaptic.scene.load import load_scene
    from canhaptic.scene.own_code import require_same_code

    overrides = log.decoded("config_overrides", list[str]())
    if log.format_version <= _LAST_OLD_FORMAT:
        overrides = overrides_now(overrides)
    path = config or Path(str(log.attributes.get("config_source", "")))
    if not path.is_file():
        raise InputError(f"{log.path}: its scene {str(path)!r} does not exist; name it with --config")
    scene = load_scene(path, overrides, allow_code=allow_code)
    resolved = log.decoded("config_resolved", dict[str, dict[str, str]]())
    require_same_code(scene.own_code, resolved.get("own_code", {}), str(log.path))
    if resolved.get("run", {}).get("code_runs_in") == "process":
        from canhaptic.scene.own_code import apart

        scene = apart(replace(scene, run=scene.run.model_copy(update={"code_runs_in": "process"})))
    hashes = [scene.config_hash(), *(earlier_hash(scene, release, resolved) for release in RELEASES)]
    if log.attributes.get("config_hash") not in hashes:
        raise InputError(
            f"{path}: is not the scene of {log.path}, or was changed since; name the right one with --config"
        )
    return scene


# --- logs of earlier releases -----------------------------------------------------------------------------------------


OLD_KEYS: Final = {"lead": "prediction_holds", "credit": "energy_allowance", "lost_frames": "max_consecutive_losses"}
"""Key of `passivity` in release 0.1 -> its name in release 0.2."""
OLD_ALGORITHMS: Final = {"direct": "unprotected", "original": "a_priori_dissipation"}
"""Algorithm of an axis in release 0.1 -> its name now."""
GONE_KEYS: Final = ("compiled", "prediction_holds", "may_cut")
"""Keys of `passivity` and `simulation` that were removed."""
_Plain = dict[str, Any]
"""A section of the configuration in effect, as JSON values."""
Release = Literal["0.1", "0.2"]
RELEASES: Final[tuple[Release, ...]] = get_args(Release)
"""Earlier releases whose logs can be compared with their scenes."""
_GONE: Final[dict[str, dict[str, _Plain]]] = {
    "axes": {"guarded": {"prediction_holds": 0.75}},
    "groups": {"": {"compiled": False}, "guarded": {"prediction_holds": 0.5, "may_cut": False}},
}
"""Owner -> algorithm ("" for all) -> removed key of `passivity` -> its default in release 0.2."""
_SECTION: Final = "passivity"
_SELECTOR: Final = "algorithm"


def overrides_now(overrides: Iterable[str]) -> list[str]:
    """Return overrides of an earlier release with today's names and without removed keys."""
    found = []
    for text in overrides:
        path, equals, value = text.partition("=")
        *owner, key = path.strip().split(".")
        if owner[-1:] == [_SECTION]:
            key = OLD_KEYS.get(key, key)
            value = OLD_ALGORITHMS.get(value.strip(), value) if key == _SELECTOR else value
        if not (owner[-1:] in ([_SECTION], ["simulation"]) and key in GONE_KEYS):
            found.append(f"{'.'.join((*owner, key))}{equals}{value}")
    return found


def earlier_hash(scene: "Scene", release: Release, logged: Mapping[str, Any] | None = None) -> str:
    """Return the hash that an earlier release would write into a log of a scene.

    Args:
        scene: Scene as loaded by this release.
        release: Release that wrote the log.
        logged: Configuration in effect in the log, for the values of removed keys; None: their defaults.
    """
    from canhaptic.scene.models import LATER_LOOP_KEYS, hash_of

    old, logged = scene.hashed(), logged or {}
    if old["simulation"] is not None:
        old["simulation"]["compiled"] = (logged.get("simulation") or {}).get("compiled", False)
    displays = {name for name, axis in old["axes"].items() if "admittance" in axis}
    for kind, gone in _GONE.items():
        for name, owner in old.get(kind, {}).items():
            if not displays.intersection(owner.get("axes", (name,))):
                then = logged.get(kind, {}).get(name, {}).get(_SECTION, {})
                _put_gone(owner[_SECTION], gone, {OLD_KEYS.get(key, key): value for key, value in then.items()})
    return hash_of(old if release == "0.2" else _in_old_names(old, LATER_LOOP_KEYS))


def _put_gone(section: _Plain, gone: Mapping[str, Mapping[str, Any]], then: Mapping[str, Any]) -> None:
    """Add the keys to a section `passivity` that its algorithm had then, in place."""
    for algorithm in ("", section[_SELECTOR]):
        section |= {key: then.get(key, default) for key, default in gone.get(algorithm, {}).items()}


def _in_old_names(old: _Plain, later: Collection[str]) -> _Plain:
    """Change a configuration to the names and keys of release 0.1, in place."""
    keys, algorithms = ({new: name for name, new in table.items()} for table in (OLD_KEYS, OLD_ALGORITHMS))
    for owner in (*old["axes"].values(), *old.get("groups", {}).values()):
        section = {keys.get(key, key): value for key, value in owner[_SECTION].items()}
        section[_SELECTOR] = algorithms.get(section[_SELECTOR], section[_SELECTOR])
        if section.get("hand_push") == section.get("hand_force"):
            section.pop("hand_push", None)
        owner[_SECTION] = section
    for axis in old["axes"].values():
        axis["loop"] = {key: value for key, value in axis["loop"].items() if key not in later}
        axis["loop"]["device_damping_bound"] = axis["loop"]["device_damping_bound"] or None
    return old
