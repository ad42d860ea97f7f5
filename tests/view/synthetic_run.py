"""A log of a hand pressing into a sampled wall, computed here in a few lines so that the views have something real."""

import math
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from canhaptic.control.balance import AT_REST, Branch
from canhaptic.logs.columns import PortDescription
from canhaptic.logs.writer_process import EnergyLogWriter
from canhaptic.signals import CycleTiming, Sample


def write_run(path: Path, cycles: int = 4000, ports: tuple[str, ...] = ("handle",), rate: int = 1000) -> None:
    path.write_bytes(_run_as_bytes(cycles, ports, rate))


@cache  # a writer process takes longer than most tests that read its log
def _run_as_bytes(cycles: int, ports: tuple[str, ...], rate: int) -> bytes:
    with TemporaryDirectory() as folder:
        _write_run(Path(folder) / "run.h5", cycles, ports, rate)
        return (Path(folder) / "run.h5").read_bytes()


def _write_run(path: Path, cycles: int, ports: tuple[str, ...], rate: int) -> None:
    wall, stiffness, damping, mass, period = -0.02, 800.0, 4.0, 0.25, 1.0 / rate
    attributes: dict[str, str | int | float] = {"config_hash": "00ff"}
    for name in ports:
        attributes |= {f"{name}.wall_position": wall, f"{name}.wall_side": "below"}
    described = [PortDescription(name, "m" if number == 0 else "rad") for number, name in enumerate(ports)]
    writer = EnergyLogWriter(path, described, attributes, sample_time_ns=round(1e9 / rate), pace="free")
    q = v = torque = surplus = deficit_h_s = 0.0
    for k in range(cycles):
        before = q
        for _ in range(10):
            hand = 0.05 * math.sin(2 * math.pi * 0.7 * k * period)
            v += (torque + 300.0 * (hand - q) - 3.0 * v) / mass * period / 10
            q += v * period / 10
        applied, depth = torque, min(0.0, q - wall)
        torque = -stiffness * depth - damping * v if depth < 0 else 0.0
        h_i, h_r = -applied * (q - before), damping * v * (q - before) if applied else 0.0
        stored = 0.5 * stiffness * depth * depth
        gen = stored - deficit_h_s + h_r - h_i
        surplus = max(0.0, surplus + gen)
        deficit_h_s = stored
        branch = Branch.EXACT if applied else Branch.FREE
        balance = AT_REST._replace(
            torque=torque, h_i=h_i, h_m=h_i, h_r=h_r, h_s=stored, h_dis=surplus, gen=gen, branch=branch.value,
            damping_rendered=damping if applied else 0.0, state=depth,
        )  # fmt: skip
        sample = Sample(k, q, applied, 0x1237, True)
        timing = CycleTiming(1000 + k % 7 * 100, 50_000 + k % 11 * 1000, 7000, 9000)
        writer.append(k, [sample] * len(ports), [balance] * len(ports), timing)
    writer.event(cycles // 2, "emcy", ports[0], "0x8130 heartbeat lost")
    writer.close()


PORTS = (PortDescription("handle", "m"),)
TIMING = CycleTiming(1, 2, 3, 4)


def append(writer: EnergyLogWriter, k: int, fresh: bool = True, timing: CycleTiming = TIMING) -> None:
    """One cycle at rest."""
    writer.append(k, [Sample(k, 0.0, 0.0, 0x1237, fresh)], [AT_REST], timing)


def write_troubled_run(path: Path) -> None:
    """100 cycles at 1 kHz: one late, three unanswered, two SYNCs of which nothing is known behind SYNC 39."""
    writer = EnergyLogWriter(path, PORTS, {}, sample_time_ns=1_000_000, pace="free")
    for k in [*range(40), *range(42, 102)]:
        lateness = 950_000 if k == 30 else 900_000  # with the rest of a cycle 5 us beyond its period, 45 us within
        append(writer, k, k not in {10, 11, 50}, CycleTiming(lateness, 30_000, 20_000, 5_000))
    writer.close()
