"""A log of any length at 1 kHz, written column by column in seconds: contacts, one spike, one fault."""

from pathlib import Path
from typing import Any

import numpy as np

from canhaptic.control.balance import Branch
from canhaptic.logs.columns import DIGEST, EVENT_TEXT_SIZES, FORMAT_NAME, FORMAT_VERSION, LogSchema, PortDescription
from canhaptic.logs.energy_sink import _PACKED_CHUNK
from canhaptic.logs.hdf5 import Hdf5File, row_digests

HOUR = 3_600_000
SPIKE = 0.7
"""Position, in one row."""


def columns_of(rows: int) -> dict[str, Any]:
    """The columns that are not zero throughout."""
    time = np.arange(rows) * 1e-3
    depth = np.minimum(0.0, 0.05 * np.sin(2 * np.pi * 0.5 * time) + 0.02)
    touching = depth < 0.0
    torque = np.where(touching, -800.0 * depth, 0.0)
    step = np.diff(depth, prepend=0.0)
    noise = np.random.default_rng(1).standard_normal(rows)
    h_i, h_r = -np.roll(torque, 1) * step + 1e-5 * np.abs(noise) * touching, np.abs(step) * 1e-4
    position = 0.05 * np.sin(2 * np.pi * 0.5 * time)
    position[rows // 3] = SPIKE
    h_i[rows // 2] -= 5.0  # the worst margin, and the account stays below
    return {
        "timing/sync_index": np.arange(rows),
        "timing/deadline_index": np.arange(rows),
        "timing/wakeup_lateness": 1000 + 500 * np.abs(noise),
        "timing/sync_to_last_tpdo": 60_000 + 4000 * np.abs(noise),
        "timing/compute": 9000 + 300 * np.abs(noise),
        "timing/send": 12_000 + 700 * np.abs(noise),
        "ports/handle/position": position,
        "ports/handle/torque_command": torque,
        "ports/handle/torque_applied": np.roll(torque, 1),
        "ports/handle/h_i": h_i,
        "ports/handle/h_r": h_r,
        "ports/handle/h_s": 400.0 * depth**2,
        "ports/handle/h_dis": 1e-5 * np.abs(noise) * touching,
        "ports/handle/fresh": np.where(np.arange(rows) % 100_003 == 5, 0, 1),
        "ports/handle/branch": np.where(touching, Branch.EXACT.value, Branch.FREE.value),
        "ports/handle/damping_rendered": np.where(touching, 4.0, 0.0),
        "ports/handle/statusword": np.full(rows, 0x1237),
    }


def write_hour(path: Path, rows: int = HOUR) -> None:
    """Writes the log."""
    columns = columns_of(rows)
    schema = LogSchema((PortDescription("handle", "m"),), 1_000_000, False, 4096, False, {})
    with Hdf5File(path, "w") as file:
        attributes: dict[str, str | int] = {
            "format": FORMAT_NAME,
            "format_version": FORMAT_VERSION,
            "sample_time_ns": 1_000_000,
        }
        more: dict[str, str | int | float] = {
            "ports": "handle m",
            "status": "completed",
            "rows_lost": 0,
            "handle.wall_position": -0.02,
        }
        file.set_attributes({**attributes, **more, "config_hash": "0" * 64})
        for column in schema.columns():
            if column.path:
                dataset = file.create(column.path, column.dtype, _PACKED_CHUNK, {"unit": column.unit})
                dataset.append(columns.get(column.path, np.zeros(rows)).astype(column.dtype))
        paths = [column.path for column in schema.stored()][:-1]
        digest = file.create(DIGEST, "u4", _PACKED_CHUNK, {})
        for start in range(0, rows, _PACKED_CHUNK):
            stop = min(rows, start + _PACKED_CHUNK)
            digest.append(row_digests([file[name].read(start, stop) for name in paths]))
        file.create("events/sync_index", "i8", 1, {}).append(np.array([rows // 4]))
        for name, size in EVENT_TEXT_SIZES.items():
            text = {"kind": b"emcy", "port": b"handle", "text": b"0x8130 heartbeat lost"}[name]
            file.create(f"events/{name}", f"S{size}", 1, {}).append(np.array([text], f"S{size}"))
