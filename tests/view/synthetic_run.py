"""A log of a hand pressing into a sampled wall, computed here in a few lines so that the views have something real."""

import math
from pathlib import Path

from canhaptic.haptics.balance import AT_REST, Branch
from canhaptic.logs.energy_log import EnergyLogWriter
from canhaptic.logs.schema import PortDescription
from canhaptic.signals import CycleTiming, Sample


def write_run(path: Path, cycles: int = 4000, ports: tuple[str, ...] = ("handle",), rate: int = 1000) -> None:
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


def append(writer: EnergyLogWriter, k: int) -> None:
    """One cycle at rest."""
    writer.append(k, [Sample(k, 0.0, 0.0, 0x1237, True)], [AT_REST], CycleTiming(1, 2, 3, 4))
