"""The same question to a bus log: with the scene from positions and torques, without it from what frames alone show."""

from collections import Counter
from pathlib import Path
from typing import Any, Final, TypedDict

import numpy as np

from canhaptic.audit.recompute import samples_of
from canhaptic.audit.why.causes import Why, explained, known_of
from canhaptic.audit.why.ripple import Motion, buzz_of
from canhaptic.canopen import objects as od
from canhaptic.canopen.code_texts import emcy_text
from canhaptic.logs.bus_reader import Remarks, is_capture, read_bus_log
from canhaptic.logs.decoder import PdoMaps, SdoDecoder
from canhaptic.logs.text_lines import UNTIMED
from canhaptic.scene.models import Scene

_NEEDED: Final = {
    "position (0x6064)": (od.POSITION_ACTUAL,),
    "torque (0x6074 or 0x6077)": (od.TORQUE_DEMAND, od.TORQUE_ACTUAL),
    "target torque (0x6071)": (od.TARGET_TORQUE,),
}
_REPEATED: Final = 3  # EMCY of one code from which it is worth a line


class WhyOfFrames(TypedDict):
    """What a bus log says of a ripple."""

    file: str
    status: str
    why: dict[str, Why]
    missing: list[str]  # signals that are needed and not in the log, each with its remedy
    said: list[str]  # what can be said without them


def why_of_frames(path: Path, scene: Scene | None) -> WhyOfFrames:
    """Return what trembles by the frames of a bus log, and which signals are missing.

    Args:
        path: The bus log.
        scene: The scene of the run; None: not known.

    Raises:
        LogFormatError: The log cannot be read, or a SYNC has no time although the scene is given.
    """
    remarks = Remarks()
    is_line = scene is not None and is_capture(path)
    missing, said = ([], []) if is_line else _of_frames(path, remarks, has_scene=scene is not None)
    why = {} if scene is None else _of_samples(path, scene)
    return {
        "file": str(path), "status": f"from the frames of {path.name}", "why": why, "missing": missing,
        "said": [*said, *remarks.lines()],
    }  # fmt: skip


def _of_samples(path: Path, scene: Scene) -> dict[str, Why]:
    """Return what trembles on each axis by the samples of its frames."""
    heard = [(periods, samples) for periods, samples, _ in samples_of(path, scene, Remarks())]
    gaps, found = np.array([periods for periods, _ in heard]), {}
    for place, axis in enumerate(scene.axes):
        known = known_of(scene, axis.parameters.name)
        position, torque = (
            np.array([getattr(samples[place], name) for _, samples in heard]) for name in ("position", "torque_applied")
        )
        motion = Motion(known.period, position, torque, None, torque != 0.0, gaps, known.unit == "rad")
        if len(position) and (buzz := buzz_of(motion, known.weight)) is not None:
            found[known.axis] = explained(known, motion, buzz, {})
            found[known.axis]["missing"].append("commands of the master as a column: no delay of the torque is tested")
    return found


def _of_frames(path: Path, remarks: Remarks, *, has_scene: bool) -> tuple[list[str], list[str]]:
    """Return the signals that are missing, and what the frames say without them."""
    counts, codes, maps = Counter[int](), Counter[int](), dict[int, PdoMaps]()
    syncs: list[int] = []
    changes, last, sdo = Counter[int](), dict[int, bytes](), dict[int, SdoDecoder]()
    for frame in read_bus_log(path, remarks):
        counts[frame.can_id] += 1
        base, node = frame.can_id & 0x780, frame.can_id & 0x7F
        if frame.can_id == od.SYNC_FRAME_COB_ID:
            syncs.append(frame.timestamp_ns)
        elif base == od.EMCY_BASE and len(frame.data) >= 2:
            codes[int.from_bytes(frame.data[:2], "little")] += 1
        elif base in (od.SDO_REQUEST_BASE, od.SDO_RESPONSE_BASE):
            _, access = sdo.setdefault(node, SdoDecoder()).sdo(frame.data, is_request=base == od.SDO_REQUEST_BASE)
            if access is not None:
                maps.setdefault(node, PdoMaps(node, None)).learn(access)
        elif base in od.TPDO_BASE:
            changes[frame.can_id] += last.get(frame.can_id) not in (None, frame.data)
            last[frame.can_id] = frame.data
    missing = [] if has_scene else _missing(maps)
    if not any(base <= can_id < base + 0x80 for can_id in counts for base in od.RPDO_BASE):
        missing.append("target torques of the master: no RPDO in the log; record the whole bus")
    return missing + _without_times(syncs), _said(counts, changes, codes, syncs)


def _missing(maps: dict[int, PdoMaps]) -> list[str]:
    mapped = {place >> 16 for of in maps.values() for _, _, mapping in of.cob_ids() for place in _objects(of, mapping)}
    remedy = "record the bring-up too, or name the scene with --config"
    return [
        f"{name}: no frame tells where it is; {remedy}" for name, any_of in _NEEDED.items() if mapped.isdisjoint(any_of)
    ]


def _objects(maps: PdoMaps, mapping: int) -> list[int]:
    fields: Any = maps.fields(mapping, bytes(8))
    return [] if isinstance(fields, str) else [field.object_index << 16 for field in fields]


def _without_times(syncs: list[int]) -> list[str]:
    if not syncs:
        return ["SYNCs: none in the log, so samples have no order in time; record the whole bus"]
    if all(time == UNTIMED for time in syncs):
        return ["times: record with `candump -L` or `-t a`; frequencies would be per SYNC, not in Hz"]
    return []


def _said(counts: Counter[int], changes: Counter[int], codes: Counter[int], syncs: list[int]) -> list[str]:
    """Return what frames alone show."""
    said = []
    times = np.diff([time for time in syncs if time != UNTIMED])
    if len(times):
        period, late = float(np.median(times)), int((times > 1.5 * np.median(times)).sum())
        said.append(f"{len(syncs)} SYNCs, every {1e-6 * period:.4g} ms, {late} of them late or after a skipped one")
    elif syncs:
        said.append(f"{len(syncs)} SYNCs without times: none can be called late or skipped")
    for can_id, changed in sorted(changes.items()):
        answered = f", {100.0 * counts[can_id] / len(syncs):.3g} % of the SYNCs" if syncs else ""
        text = f"its bytes change {changed} times" if changed else "its bytes never change: nothing moves in it"
        said.append(f"TPDO 0x{can_id:03X}: {counts[can_id]} frames{answered}; {text}")
    for code, count in codes.most_common():
        if count >= _REPEATED or code:
            said.append(f"EMCY 0x{code:04X} ({emcy_text(code)}) {count} times")
    return said
