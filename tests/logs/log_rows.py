"""Rows whose every value follows from the cycle number, so that a lost, doubled or mixed-up row shows."""

from typing import Any

from canhaptic.control.balance import EnergyBalance
from canhaptic.logs.columns import PortDescription
from canhaptic.logs.writer_process import EnergyLogWriter
from canhaptic.signals import CycleTiming, PlantEnergy, Sample, Truth

PORTS = (PortDescription("handle", "m"), PortDescription("knob", "rad"))
SAMPLE_TIME_NS = 1_000_000


def sample(k: int, port: int = 0) -> Sample:
    return Sample(k, 0.001 * k + port, -2.0 * k - port, 0x1237, k % 3 != 0)


def balance(k: int, port: int = 0) -> EnergyBalance:
    energies: list[Any] = [(k + 1) * 10.0**-n + port for n in range(10)]
    return EnergyBalance(0.5 * k + port, *energies, k % 7, 12.5, k % 5, -0.25 * k)  # type: ignore[call-arg]


def timing(k: int) -> CycleTiming:
    return CycleTiming(k, 2 * k, 3 * k, 4 * k)


def truth(k: int, port: int = 0) -> Truth:
    return Truth(0.001 * k + 0.0001 + port, PlantEnergy(1.0 * k, 2.0 * k, 3.0 * k, 4.0 * k))


def append(writer: EnergyLogWriter, k: int, ports: int = 1, with_truth: bool = True) -> None:
    numbers = range(ports)
    truths = [truth(k, n) for n in numbers] if with_truth else None
    writer.append(k, [sample(k, n) for n in numbers], [balance(k, n) for n in numbers], timing(k), truths)
